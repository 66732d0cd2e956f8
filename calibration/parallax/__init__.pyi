from ._epipolar import (
    EpipolarGeometry as EpipolarGeometry,
    epipolar_geometry as epipolar_geometry,
    find_geometry as find_geometry,
)
from ._parallax import Parallax as Parallax, find_parallax as find_parallax
from ._viewpoint import (
    FrameCamera as FrameCamera,
    Heights as Heights,
    SeenParallax as SeenParallax,
    Viewpoint as Viewpoint,
    likely_viewpoint as likely_viewpoint,
)
