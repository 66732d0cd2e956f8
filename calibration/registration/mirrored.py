"""Photographs of which one shows the scene as in a mirror.

No pose of a camera aligns them, yet symmetric parts and repeated ones agree by chance well enough
to pass for one. Whether the mirror image explains the follow-up better is therefore asked of every
pair. A scene that is its own mirror image is explained as well by either, and is not mirrored.
"""

from dataclasses import replace
from functools import cached_property
from itertools import islice

from calibration.errors import RegistrationError
from calibration.registration.candidates import Candidate, PhotographPair, best_of
from calibration.registration.feature_matches import FeatureMatches
from calibration.registration.features import ImageFeatures, homography_pose
from calibration.registration.hints import RegistrationHints
from calibration.registration.hypotheses import feature_poses, points_homography
from calibration.registration.search import searched_poses
from simulation.arrays import FloatArray
from simulation.pose import projection_slopes

_FAR_BETTER = 2.0
"""Ratio of evidence. Of 82 mirrored pairs of photographs the mirror image had 9 times as much or
more, of 41 ordinary ones at most .15 times as much."""

_BEYOND_DOUBT = 0.5
"""Evidence of a pose whose mirror image is not searched for without features. The poses on which
twelve mirrored pairs agreed by chance had .37 at most."""

_TRIED = 400
_CHANCE_MATCHES = 8
"""Features whose mirror images are matched at first, and matches of them that agree by chance."""

_LEAST_MATCHES = 12
_RATIO = 0.8
"""Matches of a mirrored pose that is judged; ratio test as for the poses that are not."""

_SENTENCE = (
    "one photograph is the mirror image of the other (viewers show FITS files top to bottom); flip "
    "one of them, or give --mirrored to align them as they are, mirrored"
)


def refuse_contradiction(hints: RegistrationHints, shape: tuple[int, int]) -> None:
    """Check that a pose that is given is mirrored as the hints say.

    Parameters
    ----------
    hints
        Those of the follow-up as it is.
    shape
        ``(rows, cols)`` of the follow-up.

    Raises
    ------
    RegistrationError
        If it is mirrored and they do not say so, or is not and they do.
    """
    given: list[tuple[str, FloatArray, tuple[float, float]]] = []
    if hints.matrix is not None:
        given.append(("pose", hints.matrix, ((shape[1] - 1) / 2, (shape[0] - 1) / 2)))
    if hints.points is not None:
        matrix = points_homography(hints.points)
        if matrix is not None:
            x, y = hints.points.followup_px.mean(axis=0).tolist()
            given.append(("points", matrix, (x, y)))
    for name, matrix, (x, y) in given:
        a, b, c, d = projection_slopes(matrix, x, y)
        if (a * d - b * c < 0) != hints.mirrored:
            says = f"by the given {name}, "
            raise not_mirrored(says) if hints.mirrored else mirrored(says)


def mirrored(says: str = "") -> RegistrationError:
    """Return the error of a pair that is mirrored; ``says`` who says so."""
    return RegistrationError(says + _SENTENCE, reason="mirrored")


def not_mirrored(says: str = "") -> RegistrationError:
    """Return the error of a pair that was said to be mirrored and is not."""
    return RegistrationError(
        f"{says}the photographs are not mirrored; leave out --mirrored", reason="not_mirrored"
    )


class MirrorImage:
    """The mirror image of a follow-up, to be compared with the reference like the follow-up.

    Parameters
    ----------
    pair
        The photographs.
    features
        Of the reference and of the follow-up.
    zoom
        Expected ratio of distances, follow-up over reference; None for any.
    """

    def __init__(
        self,
        pair: PhotographPair,
        features: tuple[ImageFeatures, ImageFeatures],
        zoom: float | None,
    ) -> None:
        self._near, self._far = features
        self._seen, self._zoom = pair, zoom

    @cached_property
    def _pair(self) -> PhotographPair:
        return replace(self._seen, followup=self._seen.followup.mirrored())

    def is_matched_better(self, best: Candidate | None) -> bool:
        """Whether matched features speak far more for it than for the follow-up's best pose."""
        if best is not None and best.is_clear and best.is_well_matched:
            some = self._far.some(_TRIED)
            share = len(some.points_px) / max(len(self._far.points_px), 1)
            least = max(share * best.hypothesis.match_count, _CHANCE_MATCHES)
            if _agreeing(self._near, some.mirrored()) <= least:
                return False
        hypotheses = feature_poses(self._near, self._far.mirrored(), self._zoom)
        first = [one for one in islice(hypotheses, 1) if one.match_count >= _LEAST_MATCHES]
        return _is_better(best_of(self._pair, first), best)

    def is_searched_better(self, best: Candidate | None) -> bool:
        """Whether it agrees far better where features tell nothing."""
        if best is not None and best.is_significant and _is_beyond_doubt(best):
            return False
        pair = self._pair
        found = best_of(pair, searched_poses(pair.reference, pair.followup, self._zoom))
        return _is_better(found, best)


def _is_beyond_doubt(best: Candidate) -> bool:
    return best.is_well_matched or best.agreement.evidence >= _BEYOND_DOUBT


def _is_better(found: Candidate | None, best: Candidate | None) -> bool:
    if found is None or not found.is_clear:
        return False
    known = best.agreement.evidence if best is not None and best.is_significant else 0.0
    return found.agreement.evidence > _FAR_BETTER * known


def _agreeing(near: ImageFeatures, far: ImageFeatures) -> int:
    """Matches that agree on one pose."""
    pairs = near.pairs_with(far, _RATIO)
    if len(pairs) <= _CHANCE_MATCHES:
        return 0
    matches = FeatureMatches(far.points_px[pairs[:, 0]], near.points_px[pairs[:, 1]])
    try:
        _, inlier = homography_pose(matches, _CHANCE_MATCHES)
    except RegistrationError:
        return 0
    return int(inlier.sum())
