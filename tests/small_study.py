"""The command line where a study has few small nets, its criteria select few features, and
simulated images are of a plane.
"""

import sys
from dataclasses import fields

from servoscope.acquisition import AcquisitionConfig
from servoscope.cli import main
from servoscope.study import StudyConfig, criteria

SMALL = {
    StudyConfig: {"n_thresholds": 4, "hidden": 4, "restarts": 1},
    AcquisitionConfig: {"part": "textured_plane"},
}
STUDY = ("study", "--n-images", "144", "--image-size", "24", "--seed", "3", "--protocol", "honest")


def make_small(set_attribute=setattr) -> None:
    """Let the settings be small unless they are given."""
    for config, values in SMALL.items():
        defaults = tuple(values.get(field.name, field.default) for field in fields(config))
        set_attribute(config.__init__, "__defaults__", defaults)
    set_attribute(criteria, "SIZES", (2, 8))


if __name__ == "__main__":
    make_small()
    sys.exit(main())
