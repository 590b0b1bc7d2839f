"""Configuration: every problem at once, with key path and line; overrides win."""

import pytest

from imud.configuration.settings import Settings
from imud.errors import ConfigError
from imud.setup import config


def test_defaults_without_a_file():
    assert config.load(None) == Settings()


def test_file_and_overrides(tmp_path):
    file = tmp_path / "imud.toml"
    file.write_text('[imu]\nprofile = "m-g350"\nmount_rpy_deg = [0, 0, 90]\n[gpsd]\nrate_hz = 5\n')
    settings = config.load(file, ["navigation.vehicle=land", "navigation.lever_arm_m=[0,0.3,0]", "gpsd.rate_hz=20"])
    assert settings.imu.profile == "m-g350"
    assert settings.imu.mount_rpy_deg == (0.0, 0.0, 90.0)
    assert settings.navigation.vehicle == "land"
    assert settings.navigation.lever_arm_m == (0.0, 0.3, 0.0)
    assert settings.gpsd.rate_hz == 20.0


def test_all_problems_at_once_with_key_and_line(tmp_path):
    file = tmp_path / "imud.toml"
    file.write_text('[imu]\nprofil = "m-g350"\nrate_hz = -1\n\n[navigation]\nvehicle = "boat"\n')
    with pytest.raises(ConfigError) as error:
        config.load(file, ["gpsd.listen=7"])
    message = str(error.value)
    assert f"{file}:2: imu.profil: unknown key; did you mean imu.profile?" in message
    assert f"{file}:3: imu.rate_hz" in message
    assert f"{file}:6: navigation.vehicle" in message and 'must be "auto" | "land" | "free"' in message
    assert "gpsd.listen" in message
    assert len(message.splitlines()) == 5


@pytest.mark.parametrize("n", [50, 51])
def test_of_many_problems_fifty_are_listed(n):
    with pytest.raises(ConfigError) as error:
        config.loads("\n".join(f"k{i} = 1" for i in range(n)))
    assert error.value.args[0].count("unknown key") == 50
    assert error.value.args[0].endswith("\n  and more") == (n > 50)


def test_a_file_may_begin_with_the_mark_of_its_encoding(tmp_path):
    file = tmp_path / "imud.toml"
    file.write_text("[gpsd]\nrate_hz = 5\n", encoding="utf-8-sig")
    assert config.load(file).gpsd.rate_hz == 5.0


def test_an_unknown_key_or_a_wrong_type_is_said_with_what_to_write():
    text = "vehicle = 'land'\n[naviagtion]\n[spi]\ndata_ready = 'gpio24'\n[stream]\nlisten = true\n[gpsd]\nlisten = 29"
    with pytest.raises(ConfigError) as caught:
        config.loads(text, name="x.toml")
    assert str(caught.value).splitlines()[1:] == [
        "  x.toml:1: vehicle: unknown key; did you mean navigation.vehicle?",
        "  x.toml:2: naviagtion: unknown key; did you mean navigation?",
        "  x.toml:4: spi.data_ready: must be text like gpiochip0:24, not 'gpio24'",
        "  x.toml:6: stream.listen: must be text, not true",
        "  x.toml:8: gpsd.listen: must be text, not 29",
    ]


@pytest.mark.parametrize(
    "text",
    [
        "[naviagtion.tuning]\nmax_speed = 3",
        "[naviagtion.a.b]",
        "naviagtion.vehicle = 'land'",
        "[gpsd]\n[naviagtion.tuning]",
    ],
)
def test_an_unknown_table_has_the_line_of_the_first_that_is_in_it(text):
    with pytest.raises(ConfigError) as caught:
        config.loads(text, name="x.toml")
    line = 1 + text.partition("naviagtion")[0].count("\n")
    assert str(caught.value).splitlines()[1:] == [f"  x.toml:{line}: naviagtion: unknown key; did you mean navigation?"]


@pytest.mark.parametrize("text", ["imu = [", "imu = 3\n", "\x00"])
def test_bad_toml_is_one_clear_error(tmp_path, text):
    file = tmp_path / "imud.toml"
    file.write_text(text)
    with pytest.raises(ConfigError):
        config.load(file)


def test_missing_file_and_malformed_override():
    from pathlib import Path

    with pytest.raises(ConfigError, match="cannot read"):
        config.load(Path("/nonexistent.toml"))
    with pytest.raises(ConfigError, match="KEY=VALUE"):
        config.load(None, ["imu.profile"])


def test_initial_values():
    initial = config.parse_initial("lat_deg=35.5,yaw_deg=-46")
    assert (initial.lat_deg, initial.yaw_deg, initial.roll_deg) == (35.5, -46.0, None)
    with pytest.raises(ConfigError, match=r"^--initial yaw: unknown key"):
        config.parse_initial("yaw=1")
    with pytest.raises(
        ConfigError, match=r"^--initial =1: write it as KEY=VALUE, for example --initial lat_deg=35\.6$"
    ):
        config.parse_initial("=1")


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ("foo", "foo: write it as KEY=VALUE, for example lat_deg=35.6$"),
        ("=3", "=3: write it as KEY=VALUE, for example lat_deg=35.6$"),
        ("yaw=3", "yaw: unknown key; did you mean yaw_deg?"),
        ("vehicle=3", "vehicle: unknown key; known here: "),
        ("a\\u0007", r"'a\\x07': write it as KEY=VALUE"),
        ("x" * 3000, "'xxx"),
    ],
)
def test_a_wrong_start_in_the_settings_is_said_in_a_line_as_it_should_be(start, said):
    with pytest.raises(ConfigError, match=rf":1: initial: {said}") as caught:
        config.loads(f'initial = "{start}"')
    assert len(str(caught.value)) < 400
    assert "\a" not in str(caught.value)


def test_hot_settings_are_applied_and_the_others_wait():
    running = config.loads("[gpsd]\nrate_hz = 5.0\n[gnss]\nmax_hdop = 3.0")
    fresh = config.loads(
        'ports = ["/dev/ttyS0"]\n[gpsd]\nrate_hz = 7.0\nlisten = "127.0.0.1:1"\n[gnss]\nmax_hdop = 3.0'
    )
    settings, taken, waiting = config.adopt(running, fresh)
    assert (taken, waiting) == (["gpsd.rate_hz"], ["ports", "gpsd.listen"])
    assert settings == config.loads("[gpsd]\nrate_hz = 7.0\n[gnss]\nmax_hdop = 3.0")
    assert config.adopt(settings, settings) == (settings, [], [])


def test_names_that_do_not_exist_are_listed_with_those_that_do():
    with pytest.raises(ConfigError) as caught:
        config.loads('estimator = "kalman"\n[imu]\nprofile = "m-g530"\n[gnss]\nmax_hdop = -1', name="x.toml")
    message = str(caught.value)
    assert "x.toml:1: estimator: there is no 'kalman'; known are auto, attitude" in message
    assert "x.toml:3: imu.profile: there is no 'm-g530'; known are auto, m-g350" in message
    assert "x.toml:5: gnss.max_hdop" in message
