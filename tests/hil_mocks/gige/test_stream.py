"""The stream of the running device, read as bytes."""

from dataclasses import replace
from time import monotonic

import numpy as np
import pytest
from numpy.typing import NDArray

import hil_mocks.gige.stream
from hil_mocks.gige import GigeFaults
from hil_mocks.gige._registers import BootstrapAddress, StreamTarget
from hil_mocks.gige._wire import PIXEL_LAYOUTS, GvcpStatus, PacketFormat
from hil_mocks.practice_bench import PracticeBench
from tests.busy_machine import BUSY_S
from tests.hil_mocks.gige_bench import expected_image, gige_bench
from tests.hil_mocks.gige_client import FRAME_S, SILENCE_S, RawClient, wait_for
from tests.hil_mocks.gige_wire import GvspError, parse_leader

FIRE = 0x8000_0000
DO_NOT_FRAGMENT = 0x4000_0000
PACKETS = -(-96 * 64 // 464)  # of a frame in packets of 500 bytes


def expected_mono8(
    bench: PracticeBench, index: int, *, acquisition: int = 1
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    return expected_image(bench, "Mono8", index=index, acquisition=acquisition)


def test_a_block_is_the_frame_of_the_source(bench: PracticeBench, client: RawClient) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    for index in range(3):
        block = client.block()
        assert block.block_id == index + 1
        assert block.packet_ids == list(range(7))  # 96 x 64 px in packets of 1464, two more
        np.testing.assert_array_equal(block.image_mono8, expected_mono8(bench, index))


def test_every_start_begins_with_block_1_and_new_noise(
    bench: PracticeBench, client: RawClient
) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    client.block()
    client.set("AcquisitionStop", 1)
    list(client.packets())
    client.set("AcquisitionStart", 1)
    block = client.block()
    assert block.block_id == 1
    np.testing.assert_array_equal(block.image_mono8, expected_mono8(bench, 0, acquisition=2))


def test_block_ids_wrap_from_65535_to_1(bench: PracticeBench, client: RawClient) -> None:
    bench.camera.begin_blocks_at(65534)
    client.start(AcquisitionFrameRateAbs=60)
    assert [client.block().block_id for _ in range(4)] == [65534, 65535, 1, 2]


def test_nothing_is_sent_while_the_stream_port_is_0(client: RawClient) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    client.block()
    client.write(BootstrapAddress.STREAM_PORT, 0)
    list(client.packets(0.1))
    assert not client.is_streamed_to()
    client.open_stream()
    assert client.block().block_id > 1


@pytest.mark.parametrize("address", [0, 0xEF010101, 0xFFFFFFFF, 0xC0A80001, 0x0A000001])
def test_nothing_is_sent_beyond_this_computer(address: int) -> None:
    target = StreamTarget(address=address, port=5000, packet_size_bytes=1500, packet_delay_ns=0)
    assert not target.is_reachable
    assert replace(target, address=0x7F000001).is_reachable
    assert not replace(target, address=0x7F000001, port=0).is_reachable


def test_a_kernel_that_cuts_no_bursts_makes_no_difference(
    bench: PracticeBench, client: RawClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hil_mocks.gige.stream, "UDP_SEGMENT", 250)  # Linux knows no such option
    client.start(AcquisitionFrameRateAbs=50)
    np.testing.assert_array_equal(client.block().image_mono8, expected_mono8(bench, 0))


def test_exposure_and_gain_act_on_the_picture(bench: PracticeBench, client: RawClient) -> None:
    bench.place("flat")
    levels = {}
    client.start(AcquisitionFrameRateAbs=50)
    for exposure_us, gain_db in ((4000.0, 0.0), (8000.0, 0.0), (4000.0, 6.0)):
        client.set("AcquisitionStop", 1)
        list(client.packets(0.1))
        client.set("ExposureTimeAbs", exposure_us)
        client.set("Gain", gain_db)
        client.set("AcquisitionStart", 1)
        levels[exposure_us, gain_db] = client.block().image_mono8.mean() - (64 - 7.5) / 16
    assert levels[8000.0, 0.0] / levels[4000.0, 0.0] == pytest.approx(2, rel=0.01)
    assert levels[4000.0, 6.0] / levels[4000.0, 0.0] == pytest.approx(10 ** (6 / 20), rel=0.01)


def test_gamma_and_black_level_act_on_the_picture(bench: PracticeBench, client: RawClient) -> None:
    bench.place("dark")
    client.start(BlackLevel=128.0, Gamma=0.5, GammaEnable=1, AcquisitionFrameRateAbs=50)
    expected = 4095 * (128 / 4095) ** 0.5 / 16  # 45.2, and half a level less by cutting off
    assert client.block().image_mono8.mean() == pytest.approx(expected - 0.5, abs=0.3)


def test_a_region_is_a_part_of_the_frame(bench: PracticeBench, client: RawClient) -> None:
    client.start(Width=40, Height=20, OffsetX=10, OffsetY=30, AcquisitionFrameRateAbs=50)
    block = client.block()
    leader = block.leader
    assert (leader.width, leader.height, leader.offset_x, leader.offset_y) == (40, 20, 10, 30)
    whole = expected_mono8(bench, 0)
    np.testing.assert_array_equal(block.image_mono8, whole[30:50, 10:50])
    assert client.get("PayloadSize") == 800


def test_the_picture_follows_the_target_and_the_stage() -> None:
    heights_mm = [200.0]
    with (
        gige_bench(height_mm=lambda: heights_mm[-1]) as bench,
        RawClient(bench.camera.address) as client,
    ):
        bench.place("brick", 90)
        client.start(TriggerMode=1, TriggerSource=6, Width=96)
        for index, height_mm in enumerate((200.0, 300.0)):
            heights_mm.append(height_mm)
            client.set("TriggerSoftware", 1)
            image = client.block().image_mono8
            np.testing.assert_array_equal(image, expected_mono8(bench, index))
            truth = bench.truth.expected_image_dn("brick", 90, height_mm, exposure_us=8000.0) / 16
            # Cut off by half a level on average; a standard deviation is at most 4 levels.
            residual = image - np.clip(truth - 0.5, 0, 255)
            assert residual.mean() == pytest.approx(0, abs=0.2)
            assert residual.std() < 4


def test_a_stage_that_goes_through_the_plane_does_not_end_the_stream() -> None:
    heights_mm = [200.0]
    with (
        gige_bench(height_mm=lambda: heights_mm[-1]) as bench,
        RawClient(bench.camera.address) as client,
    ):
        client.start(AcquisitionFrameRateAbs=50)
        client.block()
        heights_mm.append(-5.0)
        for _ in range(3):
            client.block()
        assert bench.pose.height_mm == 1.0


def test_the_frame_rate_is_kept_and_limited_by_the_exposure(client: RawClient) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    for exposure_us, period_ns in ((8000.0, 20e6), (40_000.0, 40e6)):
        client.set("ExposureTimeAbs", exposure_us)
        client.block(), client.block()
        times = [client.block().leader.timestamp_ticks for _ in range(6)]
        periods_ns = np.diff(times)
        assert periods_ns.min() > 0.99 * period_ns
        assert np.median(periods_ns) < period_ns + BUSY_S * 1e9
    assert client.get("AcquisitionFrameRateLimit") == pytest.approx(25)


def test_what_is_automatic_is_set_by_the_camera(bench: PracticeBench, client: RawClient) -> None:
    bench.place("flat")
    client.start(ExposureAuto=1, AcquisitionFrameRateAbs=50)
    while abs(client.block().image_mono8.mean() - 1500 / 16) > 2:
        pass
    # White paper: 1.5 e-/us at 5 e-/DN, over a black level of 64 DN.
    assert client.get("ExposureTimeAbs") == pytest.approx((1500 - 64) * 5 / 1.5, rel=0.02)
    client.set("ExposureAuto", 0)
    client.set("GainAuto", 1)
    client.set("ExposureTimeAbs", 1200)  # a quarter of the light
    wait_for(lambda: client.get("Gain") == 12)
    assert client.get("ExposureTimeAbs") == 1200


@pytest.mark.slow
def test_frames_wait_for_the_software_trigger(bench: PracticeBench, client: RawClient) -> None:
    client.start(TriggerMode=1, TriggerSource=6)
    assert not client.is_streamed_to()
    for index in range(3):
        assert client.set("TriggerSoftware", 1) == GvcpStatus.SUCCESS
        np.testing.assert_array_equal(client.block().image_mono8, expected_mono8(bench, index))
        assert not client.is_streamed_to(0.1)


def test_a_trigger_line_that_nothing_is_connected_to_takes_no_frame(client: RawClient) -> None:
    client.start(TriggerMode=1, TriggerSource=1)
    client.set("TriggerSoftware", 1)
    assert not client.is_streamed_to()


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "frames"), [(1, 1), (2, 3)])
def test_a_few_frames_end_by_themselves(client: RawClient, mode: int, frames: int) -> None:
    client.start(AcquisitionMode=mode, AcquisitionFrameCount=3, AcquisitionFrameRateAbs=50)
    blocks = {packet.header.block_id for packet in client.packets_of_all()}
    assert blocks == set(range(1, frames + 1))
    assert client.get("AcquisitionActive") == 0


@pytest.mark.slow
@pytest.mark.parametrize(("size", "arrives"), [(1500, True), (1504, False), (8228, False)])
def test_test_packets_pass_the_link_only_up_to_its_mtu(
    client: RawClient, size: int, *, arrives: bool
) -> None:
    client.take_control()
    client.open_stream()
    word = FIRE | DO_NOT_FRAGMENT | size
    assert client.write(BootstrapAddress.STREAM_PACKET_SIZE, word) == GvcpStatus.SUCCESS
    client.stream.settimeout(FRAME_S if arrives else SILENCE_S)
    if arrives:
        assert len(client.stream.recv(10_000)) == size - 28
    else:
        with pytest.raises(TimeoutError):
            client.stream.recv(10_000)
    read = client.read(BootstrapAddress.STREAM_PACKET_SIZE)
    assert read == DO_NOT_FRAGMENT | size  # the test bit clears itself


def test_at_power_up_no_frame_passes_a_link_of_1500_bytes(client: RawClient) -> None:
    client.start(8228, AcquisitionFrameRateAbs=50, PixelFormat=PIXEL_LAYOUTS["Mono12"].code)
    formats = [client.packet().header.packet_format for _ in range(8)]
    assert formats == [PacketFormat.LEADER, PacketFormat.TRAILER] * 4


def test_a_wider_link_carries_the_power_up_packets() -> None:
    with gige_bench(link_mtu_bytes=9000) as bench, RawClient(bench.camera.address) as client:
        client.start(8228, AcquisitionFrameRateAbs=50)
        block = client.block()
        assert block.packet_ids == [0, 1, 2]
        np.testing.assert_array_equal(block.image_mono8, expected_mono8(bench, 0))


def test_the_stream_keeps_to_its_bandwidth() -> None:
    with (
        gige_bench(simulated__width_px=400, simulated__height_px=300) as bench,
        RawClient(bench.camera.address) as client,
    ):
        # From before the first packet: a test that is late to look must not find a fast stream.
        begun_s = monotonic()
        client.start(StreamBytesPerSecond=1_000_000, AcquisitionFrameRateAbs=1)
        while client.packet().header.packet_format != PacketFormat.TRAILER:
            pass
        # 120 000 bytes in 82 packets of 36 bytes more: 0.123 s; the last packet does not wait.
        assert 0.115 < monotonic() - begun_s < 0.123 + BUSY_S
        assert client.get("AcquisitionFrameRateLimit") == pytest.approx(1e6 / 126_216, rel=1e-3)


def test_a_packet_delay_slows_the_stream_down(client: RawClient) -> None:
    client.take_control()
    client.set("GevSCPD", 20_000_000)
    begun_s = monotonic()
    client.start(500, AcquisitionFrameRateAbs=1)
    client.block()
    assert (PACKETS - 2) * 0.02 < monotonic() - begun_s < PACKETS * 0.02 + BUSY_S


def test_packets_are_sent_again_as_they_were(client: RawClient) -> None:
    client.start(500, AcquisitionFrameRateAbs=10)
    block = client.block()
    client.set("AcquisitionStop", 1)
    list(client.packets())
    client.resend(block.block_id, 0, 3)
    assert [client.packet() for _ in range(4)] == block.packets[:4]
    client.resend(block.block_id, PACKETS, 0xFFFFFF)  # to the end, trailer included
    assert [client.packet() for _ in range(2)] == block.packets[-2:]


def test_a_block_that_is_gone_is_answered_by_a_status(client: RawClient) -> None:
    client.start(500, AcquisitionFrameRateAbs=60)
    while client.block().block_id < 12:
        pass
    client.set("AcquisitionStop", 1)
    list(client.packets())
    client.resend(1, 2, 5)
    header = client.packet().header
    assert (header.status, header.block_id, header.packet_id) == (
        GvcpStatus.PACKET_UNAVAILABLE,
        1,
        2,
    )


def test_resend_can_be_disabled(bench: PracticeBench, client: RawClient) -> None:
    client.start(500, AcquisitionMode=1)
    block = client.block()
    bench.camera.faults = GigeFaults(resend_disabled=True)
    client.resend(block.block_id, 1, 3)
    assert not client.is_streamed_to()


@pytest.mark.slow
def test_lost_packets_are_seeded_and_about_as_many_as_said() -> None:
    lost = []
    for _ in range(2):
        with gige_bench() as bench, RawClient(bench.camera.address) as client:
            bench.camera.faults = GigeFaults(seed=4, packet_loss_rate=0.2)
            client.start(500, AcquisitionMode=2, AcquisitionFrameCount=20)
            came = [(p.header.block_id, p.header.packet_id) for p in client.packets_of_all()]
            sent = {(block, packet) for block in range(1, 21) for packet in range(PACKETS + 2)}
            lost.append(sent - set(came))
    assert lost[0] == lost[1]
    # 320 packets: 64 are lost, four standard deviations are 29.
    assert len(lost[0]) == pytest.approx(64, abs=29)


@pytest.mark.slow
def test_packets_can_come_twice_and_out_of_order(bench: PracticeBench, client: RawClient) -> None:
    bench.camera.faults = GigeFaults(duplicate_rate=0.3)
    client.start(500, AcquisitionMode=1)
    ids = [packet.header.packet_id for packet in client.packets_of_all()]
    assert ids == sorted(ids)
    assert len(ids) > len(set(ids)) == PACKETS + 2
    bench.camera.faults = GigeFaults(reorder_rate=0.3)
    client.set("AcquisitionStart", 1)
    ids = [packet.header.packet_id for packet in client.packets_of_all()]
    assert ids != sorted(ids)
    assert sorted(ids) == list(range(PACKETS + 2))


def test_a_stalled_camera_answers_but_sends_nothing(
    bench: PracticeBench, client: RawClient
) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    client.block()
    bench.camera.faults = GigeFaults(is_stalled=True)
    list(client.packets(0.1))
    assert client.is_answered()
    assert not client.is_streamed_to()
    bench.camera.faults = GigeFaults()
    assert client.block().leader.width == 96


def test_a_corrupt_leader_is_of_no_image(bench: PracticeBench, client: RawClient) -> None:
    bench.camera.faults = GigeFaults(corrupt_leader=True)
    client.start(AcquisitionFrameRateAbs=50)
    with pytest.raises(GvspError):
        parse_leader(client.block().packets[0].body)


def test_a_frame_of_the_wrong_size_says_so(bench: PracticeBench, client: RawClient) -> None:
    bench.camera.faults = GigeFaults(missing_rows=5)
    client.start(AcquisitionFrameRateAbs=50)
    block = client.block()
    assert (block.leader.width, block.leader.height) == (96, 59)
    assert len(block.payload) == 96 * 59


def test_a_dead_camera_sends_nothing(bench: PracticeBench, client: RawClient) -> None:
    client.start(AcquisitionFrameRateAbs=50)
    client.block()
    bench.camera.faults = GigeFaults(is_dead=True)
    wait_for(lambda: not client.is_streamed_to(0.1))


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan")])
def test_a_rate_is_from_0_to_1(value: float) -> None:
    with pytest.raises(ValueError):
        GigeFaults(packet_loss_rate=value)
    with pytest.raises(ValueError):
        GigeFaults(duplicate_rate=value)
    with pytest.raises(ValueError):
        GigeFaults(reorder_rate=value)
