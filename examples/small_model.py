"""
A small model, for the examples
===============================

Twenty-four images of the simulated cylinder head, and the model that is trained on them. The
examples that need a trained model share this one, so that it is trained once.
"""

# sphinx_gallery_thumbnail_path = "images/overview.png"

from functools import cache
from tempfile import TemporaryDirectory

import servoscope as sv
from servoscope.positioning import train

IMAGE_SIZE = 96


@cache
def head_model():
    """A keyframe model of images within 1.6 times 25 mm and 15 degrees about the part."""
    config = sv.AcquisitionConfig(schedule=[(24, 1.6)], image_size=IMAGE_SIZE)
    with TemporaryDirectory() as folder:
        data = sv.acquire(folder, config, n_jobs=1)
    return train(data, n_jobs=1)
