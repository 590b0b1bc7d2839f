"""IIO devices: layouts of scans, decoding of numbers, and samples of one or two devices."""

import struct

import numpy as np
import pytest
from framer_properties import SIZES, Decoder, identical
from hypothesis import given
from hypothesis import strategies as st

from imud.drivers.driver import Identity, ImuConfigured
from imud.drivers.iio.layout import Channel, Layout, LayoutError, layout_of, rotation_of, scan_of
from imud.drivers.registry import by_name
from imud.drivers.sample import SATURATED, SUSPECT

DRIVER = by_name("iio")
PERIOD_NS = 1_000_000


def element(name, index, kind, enabled="1"):
    parts = {"en": enabled, "index": str(index), "type": kind}
    return {f"scan_elements/{name}_{part}": text for part, text in parts.items()}


def imu(kind="le:s16/16>>0", **attributes):
    """A device with all six axes and a stamp."""
    found = {
        "name": "chip",
        "current_timestamp_clock": "monotonic",
        "in_anglvel_scale": "0.001",
        "in_accel_scale": "0.01",
    }
    for i, name in enumerate(("anglvel", "accel")):
        for k, axis in enumerate("xyz"):
            found |= element(f"in_{name}_{axis}", 3 * i + k, kind)
    return found | element("in_timestamp", 6, "le:s64/64>>0") | attributes


def configured(layout):
    return ImuConfigured(Identity("iio", "chip"), 1000.0, 1, 0, 0, layout=layout.to_text())


def single(layout, *scans):
    return Decoder(DRIVER, configured(layout)).feed(b"".join(b"\0" + scan for scan in scans))


@pytest.mark.parametrize(
    ("enabled", "places", "size"), [("1111", [0, 4, 8, 16], 24), ("1001", [0, 8], 16), ("1110", [0, 4, 8], 12)]
)
def test_channels_are_aligned_as_the_kernels_documentation_shows(enabled, places, size):
    """The example of Documentation/iio/iio_devbuf.rst, and the scan that ends with its largest channel's alignment."""
    kinds = ("be:u16/16>>0", "be:u32/32>>0", "be:u32/32>>0", "be:u64/64>>0")
    device = {}
    for i, kind in enumerate(kinds):
        device |= element(f"in_voltage{i}", i, kind, enabled[i])
    found, length = scan_of(device, 0)
    assert ([one.at for one in found.values()], length) == (places, size)


def test_repeated_channels_are_aligned_as_one():
    device = element("in_voltage0", 0, "le:u8/8") | element("in_rot_quaternion", 1, "le:s16/16X4>>0")
    found, length = scan_of(device, 0)
    assert (found["in_rot_quaternion"].at, length) == (8, 16)


@pytest.mark.parametrize("kind", ["", "le:s16", "xx:s16/16>>0", "le:s16/12>>0", "le:s16/16>>4", "le:s16/0>>0"])
def test_types_that_make_no_sense_are_refused(kind):
    with pytest.raises(LayoutError, match="in_accel_x"):
        scan_of(element("in_accel_x", 0, kind), 0)


@given(st.data())
def test_numbers_of_any_type_are_decoded(data):
    storage = data.draw(st.sampled_from([8, 16, 24, 32, 64]))
    bits = data.draw(st.integers(2, min(storage, 48)))
    shift, signed = data.draw(st.integers(0, storage - bits)), data.draw(st.booleans())
    big, junk = data.draw(st.booleans()), data.draw(st.integers(0, 2**storage - 1))
    least, most = (-(1 << bits - 1) + 2, (1 << bits - 1) - 2) if signed else (0, (1 << bits) - 2)
    values = [data.draw(st.integers(least, most)) for _ in range(3)]
    mask = ((1 << bits) - 1) << shift
    words = [(junk & ~mask) | (value & (1 << bits) - 1) << shift for value in values]
    scan = b"".join(word.to_bytes(storage // 8, "big" if big else "little") for word in words)
    kind = f"{'be' if big else 'le'}:{'s' if signed else 'u'}{bits}/{storage}>>{shift}"
    device = {"in_accel_scale": "0.5", "in_accel_offset": "3"}
    for i, axis in enumerate("xyz"):
        device |= element(f"in_accel_{axis}", i, kind)
    layout = layout_of([device])
    layout = Layout(**{**vars(layout), "periods_ns": (PERIOD_NS,)})
    (sample,) = single(layout, scan).samples
    x, y, z = ((value + 3) * 0.5 for value in values)
    assert sample["f"].tolist() == [x, -y, -z] and sample["flags"] == 0 and np.isnan(sample["temperature"])


def test_the_kernels_example_of_a_shifted_number():
    channel = scan_of(element("in_accel_y", 1, "le:s12/16>>4"), 0)[0]["in_accel_y"]
    assert channel == Channel(0, 0, 2, 12, 4, True, False) and channel.range == 2047.0


def test_scale_offset_temperature_and_mount_matrix():
    """A quarter turn to the left about z: the chip's x points where y of the board does."""
    matrix = {"in_mount_matrix": "0, -1, 0; 1, 0, 0; 0, 0, 1", "in_accel_mount_matrix": "1, 0, 0; 0, 1, 0; 0, 0, 1"}
    warm = element("in_temp0", 8, "be:u12/16>>4") | {"in_temp0_scale": "10", "in_temp_offset": "5"}
    device = imu(**matrix, **warm, in_anglvel_x_scale="0.002", in_accel_z_offset="100")
    layout = layout_of([device])
    assert layout.sizes == (32,) and layout.stamps == (16,) and layout.monotonic
    scan = struct.pack("<6h4xqH6x", 10, 20, 30, 40, 50, 60, 123, 0)
    scan = scan[:24] + struct.pack(">H", 2495 << 4 | 0xF) + bytes(6)
    (sample,) = single(Layout(**{**vars(layout), "periods_ns": (PERIOD_NS,)}), scan).samples
    assert sample["w"] == pytest.approx([-0.020, -0.020, -0.030])  # forward is -y of the chip, right is -x
    assert sample["f"] == pytest.approx([0.40, -0.50, -1.60])
    assert sample["temperature"] == pytest.approx(25.0)


@pytest.mark.parametrize("text", ["1, 0, 0; 0, 1, 0; 0, 0, -1", "2, 0, 0; 0, 2, 0; 0, 0, 2", "1, 0, 0", ""])
def test_a_mount_matrix_that_is_no_rotation_is_refused(text):
    with pytest.raises(LayoutError, match="mount matrix"):
        rotation_of({"mount_matrix": text}, "accel")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"in_accel_scale": "big"}, "no scale or offset"),
        ({"scan_elements/in_accel_z_en": "0"}, "three axes"),
        ({"scan_elements/in_accel_z_index": "?"}, "no index"),
        ({"scan_elements/in_accel_z_type": "le:s64/64>>0"}, "64 bits"),
    ],
)
def test_devices_that_cannot_be_decoded_are_refused(change, why):
    with pytest.raises(LayoutError, match=why):
        layout_of([imu() | change])
    with pytest.raises(LayoutError, match="has no scale"):
        layout_of([{name: text for name, text in imu().items() if name != "in_accel_scale"}])


def layout(**others):
    return Layout(**{**vars(layout_of([imu()])), "periods_ns": (PERIOD_NS,), **others})


def scan(stamp_ns, numbers=(1, 2, 3, 4, 5, 6)):
    return struct.pack("<6h4xq", *numbers, stamp_ns)


@given(SIZES, st.integers(1, 7))
def test_any_chunking_gives_the_same_samples(sizes, capacity):
    stream = b"".join(b"\0" + scan(n * PERIOD_NS, (n, -n, 2 * n, 7, 8, 9)) for n in range(40))
    whole = Decoder(DRIVER, configured(layout())).feed(stream)
    parts, at, i = Decoder(DRIVER, configured(layout()), capacity), 0, 0
    while at < len(stream):
        parts.feed(stream[at : at + sizes[i % len(sizes)]])
        at += sizes[i % len(sizes)]
        i += 1
    assert len(whole.samples) == 40 and identical(whole.samples, parts.samples)


def test_missing_scans_and_stamps_that_go_back_are_counted():
    start = 5_000_000_000
    times = [0, 1, 2, 12, 13, 11, 12, 12]  # periods
    decoder = single(layout(), *(scan(start + t * PERIOD_NS) for t in times))
    assert decoder.ticks == [t * PERIOD_NS for t in (0, 1, 2, 12, 13, 14, 15, 16)]
    assert (decoder["lost"], decoder["bad"], decoder["frames"]) == (9, 2, 8)


def test_without_stamps_each_scan_is_a_period():
    decoder = single(layout(stamps=(-1,)), *(scan(0) for _ in range(3)))
    assert decoder.ticks == [0, PERIOD_NS, 2 * PERIOD_NS] and decoder["lost"] == 0


def test_the_end_of_a_range_is_marked():
    ends = [32767, -32768, -32767, 32766]
    decoder = single(layout(), *(scan(i, (end, 0, 0, 0, 0, 0)) for i, end in enumerate(ends)))
    assert decoder.flags == [SATURATED, SATURATED, SATURATED, 0]


def two():
    gyro = {name: text for name, text in imu().items() if "accel" not in name}
    force = {name: text for name, text in imu().items() if "anglvel" not in name}
    found = layout_of([gyro, force])
    assert found.sizes == (16, 16) and found.stamps == (8, 8)
    return Layout(**{**vars(found), "periods_ns": (PERIOD_NS, PERIOD_NS)})


def half(stamp_ns, *numbers):
    return struct.pack("<3h2xq", *numbers, stamp_ns)


def test_force_is_interpolated_to_the_time_of_the_gyros():
    stream = b"\1" + half(0, 100, 200, 300)
    for k in range(1, 5):
        stream += b"\1" + half(k * PERIOD_NS, 100 + 40 * k, 200, 300) + b"\0" + half(k * PERIOD_NS - 250_000, k, 0, 0)
    decoder = Decoder(DRIVER, configured(two())).feed(stream)
    assert [sample["f"][0] for sample in decoder.samples] == pytest.approx(
        [(100 + 40 * (k - 0.25)) * 0.01 for k in range(1, 5)]
    )
    assert [sample["w"][0] for sample in decoder.samples] == pytest.approx([0.001 * k for k in range(1, 5)])
    assert decoder.flags == [0] * 4 and decoder.ticks == [k * PERIOD_NS for k in range(4)]


def test_force_across_a_gap_is_suspect():
    scans = (b"\1" + half(0, 1, 1, 1), b"\1" + half(8 * PERIOD_NS, 9, 9, 9), b"\0" + half(4 * PERIOD_NS, 0, 0, 0))
    assert Decoder(DRIVER, configured(two())).feed(b"".join(scans)).flags == [SUSPECT]


def test_two_devices_without_stamps_are_refused():
    device = {name: text for name, text in imu().items() if "timestamp" not in name}
    with pytest.raises(LayoutError, match="time stamps"):
        layout_of([device, device])
