from math import cos, radians, sin

import numpy as np
import pytest

from analysis.pose.pose_sentence import describe_pose
from calibration.registration import DistortedPose


@pytest.mark.parametrize(
    ("zoom", "turn_deg", "aside", "said"),
    [
        (1.0, 0.0, (0.0, 0.0), "the same distance (zoom 1.000), turned by 0.0 degrees"),
        (1.25, 10.0, (30.0, 40.0), "further away (zoom 1.250), turned by 10.0 degrees, aside by"),
        (0.8, -5.0, (0.0, 0.0), "nearer (zoom 0.800), turned by -5.0 degrees"),
    ],
)
def test_a_pose_is_told_in_an_operators_words(
    zoom: float, turn_deg: float, aside: tuple[float, float], said: str
) -> None:
    c, s = zoom * cos(radians(turn_deg)), zoom * sin(radians(turn_deg))
    turn = np.array([[c, -s], [s, c]])
    shift = np.array([199.5, 149.5]) + aside - turn @ [99.5, 74.5]
    matrix = np.array([[*turn[0], shift[0]], [*turn[1], shift[1]], [0, 0, 1]])
    pose = DistortedPose(
        matrix=matrix, k1=0.0, reference_shape=(300, 400), followup_shape=(150, 200)
    )
    assert describe_pose(pose).startswith(said)
    if any(aside):
        assert describe_pose(pose).endswith("aside by 50 px (12 % of the frame)")
