from pathlib import Path

import cv2
import numpy as np
import pytest

from servoscope import Keyframe
from servoscope.poses import pose_error

BOARD = Path(__file__).parents[3] / "shared" / "data" / "kuka_board"


@pytest.mark.slow
def test_a_real_arms_wrist_camera_is_read_to_a_millimetre_from_twenty_images():
    if not BOARD.exists():
        pytest.skip("needs shared/data/kuka_board beside the project")
    poses = np.loadtxt(BOARD / "RobotPosesVec.txt").reshape(-1, 4, 4)
    names = [BOARD / f"im_{k:02d}.jpg" for k in range(1, 29)]
    whole = [cv2.imread(str(name), cv2.IMREAD_GRAYSCALE) for name in names]
    images = np.stack([cv2.resize(i, (256, 160), interpolation=cv2.INTER_AREA) for i in whole])
    order = np.random.default_rng(0).permutation([k for k in range(28) if k != 13])
    train, test = order[:20], order[20:]
    keyframe = Keyframe.fit(images[train], poses[train], images[13], poses[13], pivot=0.0)
    found = np.stack([keyframe.align(image).displacement for image in images[test]])
    distance, angle = pose_error(poses[13] @ found, poses[test])
    assert np.median(distance) < 1.5e-3
    assert np.degrees(np.median(angle)) < 0.2
    assert distance.max() < 6e-3
