"""Settings: defaults, assignments, TOML, and errors that name what is wrong."""

import re
from pathlib import Path

import msgspec
import pytest

from mavkf.config import Config, read_config, settings, with_settings
from mavkf.errors import UsageError


def test_the_defaults_are_valid() -> None:
    assert msgspec.convert(msgspec.to_builtins(Config()), Config) == Config()
    names = [name for name, *_ in settings()]
    assert len(names) == len(set(names)) > 20
    assert len({name.split(".")[1] for name in names}) == len(names)  # so that each can be set by its key alone


def test_every_setting_has_a_meaning_and_its_default() -> None:
    for name, default, description, *_ in settings():
        section, key = name.split(".")
        assert getattr(getattr(Config(), section), key) == default
        assert len(description) > 10, name


def test_set_by_key_and_by_section() -> None:
    assert with_settings(Config(), ["window_s=2.5"]).timeline.window_s == 2.5
    assert with_settings(Config(), ["timeline.window_s=2.5"]).timeline.window_s == 2.5
    config = with_settings(Config(), ["gyro=1e-3", "vehicle.use_barometer=false", "gnss_delay_s=0.2", "reset_s=7"])
    assert (config.noise.gyro, config.vehicle.use_barometer) == (1e-3, False)
    assert with_settings(Config(), ["imu_rotation_deg=[180, 0, 45.0]"]).vehicle.imu_rotation_deg == (180.0, 0.0, 45.0)
    assert (config.vehicle.gnss_delay_s, config.gates.reset_s) == (0.2, 7.0)
    # the rest is as it was, and so is what was given
    assert with_settings(config, ["gyro=1e-4", "use_barometer=true", "reset_s=10"]) == with_settings(
        Config(), ["gnss_delay_s=0.2"]
    )
    assert Config() == with_settings(Config(), [])


def test_the_last_assignment_counts() -> None:
    assert with_settings(Config(), ["gyro=1e-3", "gyro=2e-3"]).noise.gyro == 2e-3


@pytest.mark.parametrize(
    ("assignment", "named"),
    [
        ("windows_s=1", "windows_s"),
        ("indow_s=1", "indow_s"),
        ("noise.window_s=1", "noise.window_s"),
        ("timeline.nothing=1", "timeline.nothing"),
        ("window_s", "window_s"),
        ("", "--set"),
        ("=3", "=3"),
        ("window_s=fast", "'fast'"),
        ("window_s=", "window_s="),
        ('window_s="3"', "timeline.window_s"),
        ("window_s=true", "timeline.window_s"),
        ("use_barometer=1", "vehicle.use_barometer"),
        ("window_s=0.1", "timeline.window_s"),
        ("window_s=31", "timeline.window_s"),
        ("gnss_delay_s=-0.1", "vehicle.gnss_delay_s"),
        ("gnss_delay_s=1.5", "vehicle.gnss_delay_s"),
        ("false_rejection=0", "gates.false_rejection"),
        ("false_rejection=0.5", "gates.false_rejection"),
        ("gyro=nan", "noise.gyro"),
        ("gyro=inf", "noise.gyro"),
        ("gyro=[1]", "noise.gyro"),
        ("imu_rotation_deg=90", "vehicle.imu_rotation_deg"),
        ("imu_rotation_deg=[0, 90]", "vehicle.imu_rotation_deg"),
        ("imu_rotation_deg=[0, 0, 270]", "vehicle.imu_rotation_deg[2]"),
    ],
)
def test_a_wrong_assignment_is_named(assignment: str, named: str) -> None:
    with pytest.raises(UsageError, match=re.escape(named)):
        with_settings(Config(), [assignment])


def test_one_wrong_among_right_ones_is_the_one_that_is_named() -> None:
    with pytest.raises(UsageError, match=r"--set reset_s=0: .*gates\.reset_s"):
        with_settings(Config(), ["gyro=1e-3", "reset_s=0", "window_s=2"])


def test_toml(tmp_path: Path) -> None:
    path = tmp_path / "mavkf.toml"
    path.write_text(
        "[timeline]\nwindow_s = 2.0\n\n[vehicle]\nuse_magnetometer = false\nmagnetic_declination_deg = -3.5\n"
    )
    expected = ["window_s=2.0", "use_magnetometer=false", "magnetic_declination_deg=-3.5"]
    assert read_config(path) == with_settings(Config(), expected)
    path.write_text("")
    assert read_config(path) == Config()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[timeline]\nwindow = 2.0\n", "window"),
        ("[times]\nwindow_s = 2.0\n", "times"),
        ("window_s = 2.0\n", "window_s"),
        ("[timeline]\nwindow_s = 0.0\n", "timeline.window_s"),
        ("[timeline]\nwindow_s = '2'\n", "timeline.window_s"),
        ("[timeline\n", "not TOML"),
        ("timeline = 3\n", "timeline"),
    ],
)
def test_a_wrong_file_is_named_with_its_key(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=re.escape(named)) as error:
        read_config(path)
    assert str(path) in str(error.value)


def test_a_file_that_cannot_be_read_is_a_usage_error(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(UsageError, match=re.escape(str(path))):
            read_config(path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not TOML"):
        read_config(binary)
