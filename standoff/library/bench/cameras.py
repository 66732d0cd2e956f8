"""Which cameras there are."""

from typing import TYPE_CHECKING

from simulation.arguments import checked

if TYPE_CHECKING:
    from acquisition.aravis import FoundCamera


@checked
def find_cameras() -> tuple["FoundCamera", ...]:
    """Search for cameras; this broadcasts on every network interface of this computer.

    Returns
    -------
    tuple of FoundCamera
        Address, vendor, model, serial number and id of each that answers.

    Raises
    ------
    DriverMissingError
        If Aravis or PyGObject is not installed.

    Examples
    --------
    >>> [camera.address for camera in standoff.find_cameras()]  # doctest: +SKIP
    """
    from acquisition.aravis import list_cameras  # at the call: a stand-in may take its place

    return list_cameras()
