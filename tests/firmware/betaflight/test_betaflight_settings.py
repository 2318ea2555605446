"""Tests of the interpretation of settings, without the firmware."""

import pytest

from drake_quad.errors import InputError
from drake_quad.firmware.betaflight import settings as module
from drake_quad.firmware.betaflight.settings import ANGLE, ARM, HORIZON, ModeRange, Settings

DUMP = """
# version
batch start
feature -RX_PPM
mixer QUADX
aux 0 0 0 1700 2100 0 0
aux 1 1 1 1300 1700 0 0
aux 2 0 0 900 900 0 0
set mid_rc = 1500
set angle_limit = 1

profile 0
set angle_limit = 50

profile 1
set angle_limit = 60

# restore original profile selection
profile 1

rateprofile 0
set roll_srate = 67

rateprofile 1
set roll_srate = 80

# restore original rateprofile selection
rateprofile 0

save
"""


def test_values_are_those_of_the_selected_profiles():
    settings = Settings.of(DUMP)
    assert settings.values == {"mid_rc": "1500", "angle_limit": "60", "roll_srate": "67"}
    assert settings.mixer == "QUADX"
    assert settings.mode_ranges == (ModeRange(ARM, 4, 1700, 2100), ModeRange(ANGLE, 5, 1300, 1700))


def test_switches_activate_modes():
    settings = Settings.of(DUMP)
    disarmed, armed = (
        settings.switches(modes, without) for modes, without in (({ANGLE}, {ARM}), ({ARM, ANGLE}, set()))
    )
    assert not 1700 <= disarmed[0] < 2100
    assert 1700 <= armed[0] < 2100
    assert 1300 <= disarmed[1] < 1700
    assert 1300 <= armed[1] < 1700
    assert armed[2:] == [1000] * 10


def test_modes_that_are_not_needed_stay_inactive():
    ranges = (ModeRange(ARM, 4, 1700, 2100), ModeRange(35, 4, 1900, 2100), ModeRange(ANGLE, 4, 1700, 2100))
    pulse = Settings({}, "QUADX", ranges).switches({ARM, ANGLE}, {HORIZON})[0]
    assert 1700 <= pulse < 1900


def test_impossible_modes_are_refused():
    ranges = ModeRange(ARM, 4, 900, 1200), ModeRange(ANGLE, 4, 1300, 1500)
    with pytest.raises(InputError, match="no positions of the switches activate ARM, ANGLE without HORIZON"):
        Settings({}, "QUADX", ranges).switches({ARM, ANGLE}, {HORIZON})


@pytest.mark.parametrize(
    ("line", "is_used"),
    [
        ("set d_roll = 35", True),
        ("feature -AIRMODE", True),
        ("aux 0 0 0 1700 2100 0 0", True),
        ("simplified_tuning apply", True),
        ("profile 1", True),
        ("set rpm_filter_harmonics = 3", True),  # refused by the simulator build, which has no such filter
        ("board_name SPEEDYBEEF405V3", False),
        ("resource MOTOR 1 B00", False),
        ("serial 0 64 115200 57600 0 115200", False),
        ("map TAER1234", False),
        ("set align_board_yaw = 45", False),
        ("set motor_pwm_protocol = DSHOT600", False),
        ("set OSD_units = METRIC", False),
        ("batch start", False),
        ("save", False),
    ],
)
def test_lines_that_describe_the_board_are_ignored(line, is_used):
    assert module._affects_flight(line) == is_used


def test_modes_without_a_switch_get_one_on_a_free_channel():
    settings = Settings({}, "QUADX", (ModeRange(28, 4, 1700, 2100), ModeRange(ARM, 6, 1700, 2100)), (1, 3))
    assert module._missing_mode_commands(settings) == ["aux 1 1 1 1700 2100 0 0"]
    assert module._missing_mode_commands(Settings.of(DUMP)) == []
    assert len(module._missing_mode_commands(Settings({}, "QUADX", (), (0, 1)))) == 2
    with pytest.raises(InputError, match="no switch is free for ANGLE; remove a line aux, or assign a switch"):
        module._missing_mode_commands(settings._replace(free_slots=()))


def test_free_slots_may_lie_between_used_ones():
    settings = Settings.of("aux 0 0 0 900 900 0 0\naux 1 1 1 1700 2100 0 0\naux 2 0 0 900 900 0 0")
    assert settings.mode_ranges == (ModeRange(ANGLE, 5, 1700, 2100),)
    assert module._missing_mode_commands(settings) == ["aux 0 0 0 1700 2100 0 0"]


def test_a_misspelt_command_is_refused():
    with pytest.raises(
        InputError, match="'sett d_roll = 20' begins with no command of a Betaflight diff; did you mean set"
    ):
        module._affects_flight("sett d_roll = 20")


def test_the_firmware_is_stopped_after_its_throttle_curve_is_measured(monkeypatch):
    class Firmware:
        """Firmware whose motors follow the throttle stick."""

        channels = [1500.0] * 16
        is_closed = False

        def run(self, time):
            return [0.001 * (self.channels[module.THROTTLE] - 900.0)] * 4

        def close(self):
            self.is_closed = True

    firmware = Firmware()
    monkeypatch.setattr(module, "armed", lambda *_, **__: firmware)
    commands = module._motor_commands(b"", None)
    assert commands[0] < commands[-1]
    assert firmware.is_closed
