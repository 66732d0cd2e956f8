from ._application import (
    GuidedReference as GuidedReference,
    guide_app as guide_app,
    guide_pages as guide_pages,
)
from ._assessment import Assessment as Assessment, Judge as Judge
from ._certificate import Certificate as Certificate, made_certificate as made_certificate
from ._live import LiveGuidance as LiveGuidance
from ._network import network_address as network_address, qr_text as qr_text
from ._reference import GuideReference as GuideReference
from ._shelf import ReferenceShelf as ReferenceShelf
from ._stills import ComparisonInputs as ComparisonInputs, StillStore as StillStore
