"""CSV in and out: exact numbers, and errors that name the line."""

import gzip
import io
import math
import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea_lines import gga

from imud.configuration.settings import Gnss
from imud.errors import BadDataError, InputMissingError
from imud.estimators.records import POSITION_VALID, SOLUTION
from imud.math.decimal import write_fixed, write_seconds
from imud.math.rotation import quat_of_euler
from imud.sensors.gnss import IMPOSSIBLE, INACCURATE, refusals
from imud.tables import estimates as estimate_tables
from imud.tables import inputs as tables
from imud.tables.imu_table import write_rows
from imud.tables.nmea_log import fixes_of_log

HEADER = "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2,az_mps2\n"


def text(value, decimals):
    buffer = np.zeros(64, np.uint8)
    return bytes(buffer[: write_fixed(buffer, 0, value, decimals)]).decode()


@given(st.floats(-1e8, 1e8), st.integers(0, 9))
def test_fixed_decimals_are_pythons_own(value, decimals):
    ours = text(value, decimals)
    assert abs(float(ours) - value) <= 0.5000001 * 10.0**-decimals + abs(value) * 4e-16
    assert len(ours.partition(".")[2]) == decimals


@given(st.floats(-9e18, 9e18), st.integers(0, 18))
def test_fixed_decimals_are_the_digits_of_the_rounded_integer(value, decimals):
    scaled = abs(value) * 10**decimals + 0.5
    digits = f"{int(scaled):0{decimals + 1}d}" if scaled < 9.2e18 else ""
    whole, fraction = digits[: len(digits) - decimals], digits[len(digits) - decimals :]
    sign = "-" if value < 0.0 and digits.strip("0") else ""
    assert text(value, decimals) == sign + whole + ("." if fraction else "") + fraction


@pytest.mark.parametrize(
    ("value", "decimals", "expected"),
    [
        (0.0, 2, "0.00"),
        (-0.001, 2, "0.00"),
        (-1.5, 0, "-2"),
        (35.6585805, 7, "35.6585805"),
        (math.nan, 3, ""),
        (1e300, 3, ""),
        (0.99996, 4, "1.0000"),
        (-9.99996, 4, "-10.0000"),
        (9_999_999.96, 1, "10000000.0"),
    ],
)
def test_fixed_decimals(value, decimals, expected):
    assert text(value, decimals) == expected


def test_each_four_digits_are_right():
    assert [text(number, 0) for number in range(10_000)] == [str(number) for number in range(10_000)]
    assert [text(number * 1e-4, 4) for number in range(10_000)] == [f"0.{number:04d}" for number in range(10_000)]


def test_seconds_are_exact_to_the_nanosecond():
    buffer = np.zeros(64, np.uint8)
    for t_ns in (0, 1, 1_700_000_000_123_456_789, -1_500_000_001):
        written = bytes(buffer[: write_seconds(buffer, 0, t_ns)]).decode()
        whole, _, fraction = written.partition(".")
        assert int(whole + fraction) == t_ns


def write(tmp_path, body, header=HEADER):
    path = tmp_path / "in.csv"
    path.write_text(header + body)
    return path


def test_samples_keep_their_values_and_times(tmp_path):
    path = write(tmp_path, "373424.0001,1,2,3,4,5,6\n373424.0101,-1,-2,-3,-4,-5,-6\n")
    samples, origin, skipped = tables.read_imu(path)
    assert (origin, skipped) == (373424, 0)
    assert samples["t_ns"].tolist() == [100_000, 10_100_000]
    assert samples["w"].tolist() == [[1, 2, 3], [-1, -2, -3]]
    assert samples["f"].tolist() == [[4, 5, 6], [-4, -5, -6]]


def test_columns_go_by_name_and_others_are_ignored(tmp_path):
    path = write(
        tmp_path, "9,6,5,4,3,2,1,0\n9,6,5,4,3,2,1,1\n", "temp,az_mps2,ay_mps2,ax_mps2,gz_radps,gy_radps,gx_radps,t_s\n"
    )
    samples, _, _ = tables.read_imu(path)
    assert samples["w"][0].tolist() == [1, 2, 3]
    assert samples["f"][0].tolist() == [4, 5, 6]


def test_a_temperature_that_is_not_known_costs_no_sample(tmp_path):
    path = write(tmp_path, "0,1,2,3,4,5,6,\n1,1,2,3,4,5,6,21.5\n", f"{HEADER.strip()},temperature_c\n")
    samples, _, _ = tables.read_imu(path)
    assert samples["temperature"].tolist() == [pytest.approx(math.nan, nan_ok=True), 21.5]


def test_time_that_stands_or_runs_back_is_skipped_and_counted(tmp_path):
    rows = "".join(f"{t},0,0,0,0,0,-9.8\n" for t in (0, 0.01, 0.01, 0.005, 0.02))
    samples, _, skipped = tables.read_imu(write(tmp_path, rows))
    assert skipped == 2
    assert samples["t_ns"].tolist() == [0, 10_000_000, 20_000_000]


@pytest.mark.parametrize("second", ["0", "1e-300", "3e-10"])
def test_two_samples_of_one_nanosecond_are_too_few(second, tmp_path):
    with pytest.raises(BadDataError, match="of 2 samples only 1 have a later t_s"):
        tables.read_imu(write(tmp_path, f"0,0,0,0,0,0,-9.8\n{second},0,0,0,0,0,-9.8\n"))


@given(st.lists(st.integers(0, 30), min_size=2, max_size=12))
def test_of_times_in_disorder_as_many_samples_as_can_be_are_kept(times):
    kept = [times[i] for i in tables._in_order(np.array(times, float))]
    best = [1] * len(times)
    for i, time in enumerate(times):
        best[i] = 1 + max([best[j] for j in range(i) if times[j] < time], default=0)
    assert kept == sorted(set(kept)) and len(kept) == max(best)


def test_one_time_far_ahead_costs_one_sample(tmp_path):
    rows = "".join(f"{1e18 if i == 2 else i / 100},0,0,0,0,0,-9.8\n" for i in range(100))
    samples, _, skipped = tables.read_imu(write(tmp_path, rows))
    assert (len(samples), skipped) == (99, 1)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("1e300,1,2,3,1,9,", "line 2: t_s is 1e300"),
        ("0,1,2,3,1e12,9,", "line 2: quality is 1000000000000.0"),
        ("0,1,2,3,1,-1e30,", "line 2: satellites is -1e30"),
        ("0,1,2,3,1,9,-5", "line 2: arrival_s is -5.000, before t_s"),
    ],
)
def test_a_fix_that_cannot_be_is_left_out(tmp_path, row, says):
    header = "t_s,lat_deg,lon_deg,height_m,quality,satellites,arrival_s\n"
    left_out = tables.SkippedRows(tmp_path)
    rows = f"{row}\n1,1,2,3,0,9,\n2e12,1,2,3,,,\n"
    fixes = tables.read_fixes(write(tmp_path, rows, header), 0, left_out)
    assert says in str(left_out)
    assert (left_out.count, len(fixes)) == (1, 1)  # one said itself that it has no position
    assert fixes["t_ns"][0] == 9_000_000_000_000_000_000  # a time in ms, probably: nobody's, but told by who compares


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("0,0,0,0,0,0,-9.8\n0.01,0,x,0,0,0,-9.8\n", "line 3: gy_radps is 'x'"),
        ("0,0,0,0,0,0,-9.8\n0.01,0,nan,0,0,0,-9.8\n", "line 3: gy_radps is nan"),
        ("0,0,0,0,0,0,-9.8\n0.01,0,0\n", "line 3: 3 columns"),
        ("", "0 samples"),
    ],
)
def test_bad_samples_are_named_by_line_and_column(tmp_path, body, says):
    with pytest.raises(BadDataError, match=says):
        tables.read_imu(write(tmp_path, body))


FORMS = {
    "semicolons, decimal commas": lambda text: text.replace(",", ";").replace(".", ",").encode(),
    "tabs": lambda text: text.replace(",", "\t").encode(),
    "quotes": lambda text: "".join(f'"{cell}"' if cell not in ",\n" else cell for cell in _CELLS.split(text)).encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "BOM and CR LF": lambda text: text.replace("\n", "\r\n").encode("utf-8-sig"),
    "CR alone": lambda text: text.replace("\n", "\r").encode(),
    "gzip": lambda text: gzip.compress(text.encode()),
    "gzip, then something else": lambda text: gzip.compress(text.encode()) + b"\x1f\x8cpadding of a logger",
    "comments": lambda text: f"# a logger\n# 3; of 4\n{text}".encode(),
    "units below the header": lambda text: text.replace("\n", "\ns,deg/s,deg/s,,m/s^2,m/s^2,g\n", 1).encode(),
    "units and decimal commas": lambda text: (
        text.replace(",", ";").replace(".", ",").replace("\n", "\ns;;;;;;-\n", 1).encode()
    ),
    "a commented header": lambda text: f"# {text}".encode(),
    "cut off": lambda text: f"{text}0.02,1,2,-".encode(),
    "cut off by a loss of power": lambda text: text.encode() + bytes(512),
    "cut off by a loss of power in a row": lambda text: f"{text}0.02,1".encode() + bytes(1 << 20),
}
_CELLS = re.compile("([,\n])")


@pytest.mark.parametrize("form", FORMS)
def test_a_table_of_any_make_is_read_as_the_plain_one(tmp_path, form):
    body = HEADER + "0.0,1.5,-2,3,4,5,6\n0.01,1,2,3,4.25,5,-9.8\n"
    path = tmp_path / "in.csv"
    path.write_bytes(FORMS[form](body))
    samples, _, _ = tables.read_imu(path)
    plain, _, _ = tables.read_imu(write(tmp_path, body, ""))
    assert samples.tobytes() == plain.tobytes()


@pytest.mark.parametrize("zipped", [False, True])
def test_a_line_without_an_end_is_not_read_into_memory(tmp_path, zipped):
    """As of a small file that unzips to gigabytes."""
    path = tmp_path / "in.csv"
    body = (HEADER + "0,0,0,0,0,0,-9.8\n").encode() + b"1" * (64 << 20)
    path.write_bytes(gzip.compress(body) if zipped else body)
    del body
    tracemalloc.start()
    try:
        with pytest.raises(BadDataError, match="line 3: longer than 64 KiB"):
            tables.read_imu(path)
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.thorough
@pytest.mark.parametrize("zipped", [False, True])
def test_a_log_that_unzips_to_much_is_read_in_pieces(tmp_path, zipped):
    path = tmp_path / "track.nmea"
    body = b"".join(gga(f"12000{k}.000") for k in range(3)) + bytes(64 << 20)
    path.write_bytes(gzip.compress(body) if zipped else body)
    del body
    tracemalloc.start()
    try:
        assert len(fixes_of_log(path, 0, 0, Gnss())) == 3
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("row", ["x", "s,deg/s,1,,m/s^2,m/s^2,g"])
def test_what_may_be_a_bad_row_is_not_taken_for_units(tmp_path, row):
    with pytest.raises(BadDataError, match="line 2: t_s is"):
        tables.read_imu(write(tmp_path, f"{row}\n0,0,0,0,0,0,-9.8\n0.01,0,0,0,0,0,-9.8\n"))


def test_bad_rows_are_left_out_and_then_named(tmp_path):
    rows = ["0,0,0,0,0,0,-9.8", "0.01,0,x,0,0,0,-9.8", "0.02,0,0,0,0,0,nan", "0.03,0,0,0,0,0,-9.8"]
    left_out = tables.SkippedRows(tmp_path / "in.csv")
    samples, _, _ = tables.read_imu(write(tmp_path, "\n".join(rows) + "\n"), left_out)
    assert samples["t_ns"].tolist() == [0, 30_000_000]
    with pytest.raises(BadDataError, match="2 rows left out, the first of them is line 3: gy_radps is 'x'"):
        left_out.judge(len(samples))
    left_out = tables.SkippedRows(tmp_path / "in.csv")
    with pytest.raises(BadDataError, match="line 2: t_s is '12:00:00', not a number; 0 samples"):
        tables.read_imu(write(tmp_path, "12:00:00,0,0,0,0,0,-9.8\n"), left_out)


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ((1.7e18, 1.7e18 + 1e7), "is it in ms, us or ns"),
        ((3, 2, 1, 0), "not sorted by it"),
        ((1, 1, 1, 1, 2), "too few digits"),
        ([1.7e18 + 1e7 * i for i in range(2000)], "is it in ms, us or ns"),
    ],
)
def test_times_of_another_unit_or_order_are_reported(tmp_path, times, says):
    with pytest.raises(BadDataError, match=says):
        tables.read_imu(write(tmp_path, "".join(f"{t},0,0,0,0,0,-9.8\n" for t in times)))


def test_rows_of_a_receiver_without_a_fix_are_no_fixes(tmp_path):
    rows = "1,,,,\n2,nan,nan,nan,1\n3,35.5,139.5,,1\n"
    fixes = tables.read_fixes(write(tmp_path, rows, "t_s,lat_deg,lon_deg,height_m,hdop\n"), 0)
    assert fixes["t_ns"].tolist() == [3_000_000_000]


def test_minus_one_of_a_phone_is_unknown(tmp_path):
    header = "t_s,lat_deg,lon_deg,height_m,sn_m,hdop,speed_mps,course_deg,vd_mps\n"
    fix = tables.read_fixes(write(tmp_path, "1,-35.5,-139.5,-1,-1,-1,-1,-1,-1\n", header), 0)[0]
    assert np.isnan([fix["sigma"][0], fix["hdop"], fix["speed"]]).all()
    assert (fix["height"], fix["v"][2]) == (-1.0, -1.0)


def test_a_sigma_of_zero_is_unknown_and_a_speed_of_zero_is_not(tmp_path):
    header = "t_s,lat_deg,lon_deg,height_m,sn_m,svn_mps,hdop,speed_mps\n"
    fix = tables.read_fixes(write(tmp_path, "1,35.5,139.5,0,0,0,0,0\n", header), 0)[0]
    assert np.isnan([fix["sigma"][0], fix["sigma_v"][0], fix["hdop"]]).all()
    assert fix["speed"] == 0.0


def test_an_accuracy_that_no_receiver_can_have_is_unknown_as_it_is_live(tmp_path):
    header = "t_s,lat_deg,lon_deg,height_m,sn_m,se_m,sd_m,hdop\n"
    rows = "1,35.5,139.5,40,1e-9,2e-4,2e-3,1e-4\n2,35.5,139.5,40,5,5,4294967.295,0.4\n3,35.5,139.5,40,2e4,5,5,0.8\n"
    sure, vague, nowhere = fixes = tables.read_fixes(write(tmp_path, rows, header), 0)
    assert np.isnan([*sure["sigma"][:2], sure["hdop"]]).all()
    assert (sure["height"], sure["sigma"][2]) == (40.0, 2e-3)
    assert np.isnan([vague["height"], vague["sigma"][2]]).all()
    assert (vague["sigma"][0], vague["hdop"]) == (5.0, 0.4)
    assert nowhere["sigma"][0] == 2e4
    assert refusals(fixes, Gnss()) == [None, None, INACCURATE]


def test_a_position_of_0_0_is_none_unless_all_are_there(tmp_path):
    """Programs log it as long as the receiver has no fix; simulated drives begin there."""
    rows = "1,0,0,0\n2,0,0.01,0\n", "1,0,0,0\n2,,,\n3,0,139.5,40\n"
    simulated, logged = (tables.read_fixes(write(tmp_path, text, "t_s,lat_deg,lon_deg,height_m\n"), 0) for text in rows)
    assert refusals(simulated, Gnss()) == [None, None]
    assert refusals(logged, Gnss()) == [IMPOSSIBLE, None]


def test_a_column_that_is_there_twice_is_refused(tmp_path):
    path = tmp_path / "imu.csv"
    path.write_text(HEADER.strip() + ",gx_radps\n" + "".join(f"{k},0,0,0,0,0,-9.8,5\n" for k in range(3)))
    with pytest.raises(BadDataError, match="line 1: more than one column gx_radps"):
        tables.read_imu(path)


def test_missing_file_and_missing_column(tmp_path):
    with pytest.raises(InputMissingError, match="no such file"):
        tables.read_imu(tmp_path / "absent.csv")
    with pytest.raises(BadDataError, match="no column az_mps2"):
        tables.read_imu(write(tmp_path, "", "t_s,gx_radps,gy_radps,gz_radps,ax_mps2,ay_mps2\n"))


def test_another_kind_of_file_is_reported(tmp_path):
    with pytest.raises(BadDataError, match=r"1: the header must name t_s, .*; it is: time \[s\], gyro_x, Acc Z, …"):
        tables.read_imu(write(tmp_path, "1,2,3\n", f"time [s],gyro_x,Acc Z,{'x' * 200}\n"))
    with pytest.raises(BadDataError, match=r"\(separated by commas, semicolons or tabs\); it is: t_s gx_radps "):
        tables.read_imu(write(tmp_path, "1 2 3\n", HEADER.replace(",", " ")))
    with pytest.raises(BadDataError, match="line 1: there is no header; it must name t_s, "):
        tables.read_imu(write(tmp_path, "0.01,0,0,0,0,0,-9.8\n", "0.00,0,0,0,0,0,-9.8\n"))
    (tmp_path / "raw.ubx").write_bytes(bytes(range(256)) * 4)
    with pytest.raises(BadDataError, match=r"raw\.ubx: not a text, so no table and no NMEA log either"):
        tables.read_fixes(tmp_path / "raw.ubx", 0)


def test_fixes_with_and_without_optional_columns(tmp_path):
    path = write(
        tmp_path,
        "11.0,11.25,35.5,139.5,40.0,0.9,1.5,90\n10.0,10.25,35.5,139.5,40.0,,0.0,\n",
        "t_s,arrival_s,lat_deg,lon_deg,height_m,hdop,speed_mps,course_deg\n",
    )
    fixes = tables.read_fixes(path, 10)
    assert fixes["t_ns"].tolist() == [0, 1_000_000_000]
    assert fixes["arrival_ns"].tolist() == [250_000_000, 1_250_000_000]
    assert fixes["course"][1] == pytest.approx(math.pi / 2)
    assert np.isnan([fixes["course"][0], fixes["hdop"][0], fixes["sigma"][0, 0], fixes["v"][0, 0]]).all()
    path = write(tmp_path, "1,35.5,139.5,40.0\n", "t_s,lat_deg,lon_deg,height_m\n")
    assert tables.read_fixes(path, 0)["arrival_ns"].tolist() == [1_000_000_000]


@pytest.mark.parametrize(
    ("row", "says"),
    [
        *[("1,95,0,0", "lat_deg is 95"), ("1,a,0,0", "line 2"), (",1,1,1", "t_s is empty")],
        *[("1,1,1,1e9", "height_m is 1000000000"), ("1,,1,1", "lat_deg is nan"), ("1,1,1,1,3e8", "vn_mps is 3")],
        *[
            ("1,1,1,1,0,0,2e4", "speed_mps is 20000"),
            ("1,1,1,1,3", "vn_mps without ve_mps"),
            ("1,1,1,1,,3", "ve_mps without vn_mps"),
        ],
    ],
)
def test_bad_fixes_are_named_by_line(tmp_path, row, says):
    columns = ("t_s", "lat_deg", "lon_deg", "height_m", "vn_mps", "ve_mps", "speed_mps")
    header = ",".join(columns[: len(row.split(","))])
    with pytest.raises(BadDataError, match=says):
        tables.read_fixes(write(tmp_path, f"{row}\n", f"{header}\n"), 0)


def test_estimates_are_written_in_the_columns_of_the_contract():
    rows = np.zeros(2, SOLUTION)
    rows["t_ns"] = [500_000_000, 501_000_000]
    rows["status"] = [POSITION_VALID, 0]
    rows["lat"], rows["lon"], rows["height"] = math.radians(35.5), math.radians(-139.25), 12.5
    rows["v"] = [1.0, -2.0, 0.5]
    rows["q_nb"] = quat_of_euler(math.radians(10), math.radians(-5), math.radians(120))
    rows["sigma_p"], rows["sigma_v"] = [1, 2, 3], [0.1, 0.2, 0.3]
    rows["sigma_rpy"] = np.radians([0.1, 0.2, 5.0])
    file = io.BytesIO()
    estimate_tables.EstimateWriter(file, 100).write(rows)
    header, first, second = file.getvalue().decode().splitlines()
    assert header.startswith(
        "t_s,lat_deg,lon_deg,height_m,vn_mps,ve_mps,vd_mps,roll_deg,pitch_deg,yaw_deg,sn_m,se_m,sd_m,"
    )
    assert len(first.split(",")) == len(header.split(","))
    cells = dict(zip(header.split(","), first.split(","), strict=True))
    expected = {
        "t_s": 100.5, "lat_deg": 35.5, "lon_deg": -139.25, "height_m": 12.5, "vn_mps": 1, "ve_mps": -2, "vd_mps": 0.5,
        "roll_deg": 10, "pitch_deg": -5, "yaw_deg": 120, "sn_m": 1, "se_m": 2, "sd_m": 3, "svd_mps": 0.3, "syaw_deg": 5,
    }  # fmt: skip
    for name, value in expected.items():
        assert float(cells[name]) == pytest.approx(value, abs=1e-5), name
    blank = dict(zip(header.split(","), second.split(","), strict=True))
    assert [blank[name] for name in ("lat_deg", "height_m", "vd_mps", "sn_m", "svn_mps")] == [""] * 5
    assert float(blank["yaw_deg"]) == pytest.approx(120)


@given(st.lists(st.tuples(st.integers(0, 2**62), st.floats(), st.floats(width=32)), max_size=5))
def test_rows_of_samples_give_every_time_and_number_back(rows):
    times = np.array([t_ns for t_ns, *_ in rows], np.int64)
    file = io.BytesIO()
    write_rows(file, times, np.array([numbers for _, *numbers in rows]).reshape(-1, 2))
    lines = file.getvalue().decode().splitlines()
    assert len(lines) == len(rows)
    for line, (t_ns, *numbers) in zip(lines, rows, strict=True):
        time, *cells = line.split(",")
        assert time == f"{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}"
        assert [float(cell) if cell else None for cell in cells] == [x if math.isfinite(x) else None for x in numbers]


@given(st.integers(0, 2**32 - 1))
def test_a_row_that_follows_others_has_the_text_of_one_alone(seed):
    rng = np.random.default_rng(seed)
    rows = np.zeros(6, SOLUTION)
    rows["status"] = rng.choice([0, POSITION_VALID], 6)  # without a position, cells of the row before are empty
    for name in ("v", "q_nb", "sigma_p", "sigma_rpy", "bg", "ba", "sigma_ba"):
        rows[name] = rng.choice([0.0, -0.0, 1.0, -1234.5, math.nan, math.inf, rng.normal()], rows[name].shape)

    def text(part):
        file = io.BytesIO()
        estimate_tables.EstimateWriter(file, 0).write(part)
        return file.getvalue().decode().splitlines()[1:]

    assert text(rows) == [line for k in range(6) for line in text(rows[k : k + 1])]
