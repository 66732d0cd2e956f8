"""The simulated camera, whose frames' true exposures a test knows and the code under test not."""

from dataclasses import replace

from acquisition.devices import CameraSettings, DeviceInfo, Frame, StreamStatistics
from hil_mocks.devices import CameraFaults, SimulatedCamera


class WatchedCamera:
    """Passes everything on; ``true_us`` has the exposure of each frame by its pixels.

    The camera states the exposure of its frames, which is taken off unless ``is_told``.
    """

    def __init__(
        self, camera: SimulatedCamera, delay: tuple[int, int], seed: int, *, is_told: bool = False
    ) -> None:
        camera.faults = CameraFaults(seed=seed, exposure_delay_frames=delay, states_exposure=True)
        self.true_us: dict[bytes, float] = {}
        self._camera = camera
        self._is_told = is_told

    @property
    def info(self) -> DeviceInfo:
        return self._camera.info

    @property
    def settings(self) -> CameraSettings:
        return self._camera.settings

    def set_exposure_us(self, exposure_us: float) -> float:
        return self._camera.set_exposure_us(exposure_us)

    def set_gain_db(self, gain_db: float) -> float:
        return self._camera.set_gain_db(gain_db)

    def start(self) -> None:
        self._camera.start()

    def next_frame(self, timeout_s: float) -> Frame:
        frame = self._camera.next_frame(timeout_s)
        if frame.exposure_us is None:
            return frame
        self.true_us[frame.image_dn.tobytes()] = frame.exposure_us
        return frame if self._is_told else replace(frame, exposure_us=None)

    def stop(self) -> None:
        self._camera.stop()

    def statistics(self) -> StreamStatistics:
        return self._camera.statistics()

    def close(self) -> None:
        self._camera.close()
