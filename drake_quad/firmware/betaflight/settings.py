"""Settings of Betaflight as pilots write them: lines of its command line, such as the output of `diff`."""

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.caching import ThreadSafeCache
from drake_quad.errors import InputError, did_you_mean, join_names, short_repr
from drake_quad.firmware.betaflight.flight_controller import LOW_PULSE, THROTTLE, Betaflight
from drake_quad.firmware.betaflight.messages import NUM_CHANNELS
from drake_quad.firmware.controller import FirmwareError

ARM, ANGLE, HORIZON = 0, 1, 2
"""Numbers of flight modes in the command `aux`."""
_MODE_NAMES = {ARM: "ARM", ANGLE: "ANGLE", HORIZON: "HORIZON"}
_FIRST_AUX_CHANNEL = 4  # index of the channel AUX1; the channels before it belong to the sticks
_SWITCH_RANGE = (1700, 2100)  # µs; range of a switch that this module assigns to a mode
_MAX_PULSE = 2100  # µs
# Commands that affect a simulated flight.
_FLIGHT_COMMANDS = ("adjrange", "aux", "feature", "mixer", "mmix", "profile", "rateprofile", "set", "simplified_tuning")
# Other commands of a `diff` or a `dump`, which describe the board and its wiring.
_BOARD_COMMANDS = (
    *("batch", "beacon", "beeper", "board_name", "color", "defaults", "diff", "dma", "dump", "led", "manufacturer_id"),
    *("map", "mcu_id", "mode_color", "name", "resource", "rxfail", "rxrange", "save", "serial", "servo", "signature"),
    *("smix", "timer", "vtx", "vtxtable"),
)
# Beginnings of the names of settings that describe the board, its sensors, the battery or the radio. They have no
# effect on a simulated vehicle, whose sensors have the axes of the body, or are not part of the simulator build.
_BOARD_SETTINGS = (
    *("acc_calibration", "align_board", "baro_", "battery_", "bat_capacity", "beeper", "blackbox", "camera", "cc2500"),
    *("crsf", "current_meter", "debug", "displayport", "dshot", "esc_sensor", "expresslrs", "flash", "frsky", "gps_"),
    *("gyro_1", "gyro_2", "gyro_calib", "gyro_cal_", "gyro_to_use", "ibat", "led", "mag_", "mcu_", "motor_poles"),
    *("motor_pwm", "osd", "pilot_name", "craft_name", "name", "pinio", "pwr_on_arm_grace", "rcdevice", "rssi", "rx_"),
    *("scheduler", "sdcard", "serialrx", "stats", "system_hse", "telemetry", "tlm_", "tri_", "use_unsynced_pwm"),
    *("usb", "vbat", "vcd", "voltage_meter", "vtx"),
)
_ERROR_PATTERN = re.compile(r"###ERROR[^#]*###")
# Throttle calibration: pulse widths (µs), and the duration until the motors have settled at each of them.
_THROTTLE_PULSES = np.arange(1000.0, 2001.0, 50.0)
_SETTLING_TIME = 0.15  # s; fourteen time constants of the filter of `throttle_boost_cutoff`, 15 Hz
# Settings that shorten the start: the firmware may be armed at once, calibrates the gyroscope with as few samples as it
# allows, and does not calibrate the barometer, which neither the angle mode nor the acro mode uses.
_START_SETTINGS = ("set pwr_on_arm_grace = 0", "set gyro_calib_duration = 50", "set baro_hardware = NONE")
_CALIBRATION_TIME = 4.0  # s from the initialization to the end of all calibrations, which was measured as 3.5 s
_TEST_PULSE = 1300  # µs; pulse width of the throttle stick at which the motors of an armed vehicle turn
_ARMING_TIME = 0.3  # s that the firmware needs to recognise the switch


class ModeRange(NamedTuple):
    """Range of a channel in which a flight mode is active, as the command `aux` defines it.

    Attributes:
        mode: number of the mode.
        channel: index of the channel, counted from 0.
        start: smallest pulse width, µs.
        end: end of the range, µs.
    """

    mode: int
    channel: int
    start: int
    end: int

    def contains(self, pulse: float) -> bool:
        """Return whether the range contains a pulse width, µs."""
        return self.start <= pulse < self.end


class Settings(NamedTuple):
    """Settings of the firmware, as it prints them.

    Attributes:
        values: values of the command `set` by name, in the selected profiles.
        mixer: name of the mixer, such as QUADX.
        mode_ranges: ranges in which the flight modes are active.
        free_slots: numbers of the command `aux` that define no range.
    """

    values: Mapping[str, str]
    mixer: str
    mode_ranges: tuple[ModeRange, ...]
    free_slots: tuple[int, ...] = ()

    @classmethod
    def of(cls, dump: str) -> "Settings":
        """Return the settings, given the output of `dump all`."""
        sections: dict[str, dict[str, str]] = {"": {}}
        section, selected, mixer = "", {"profile": "", "rateprofile": ""}, ""
        ranges, free_slots = [], []
        for line in map(str.strip, dump.splitlines()):
            word, _, rest = line.partition(" ")
            if word in selected:
                section = selected[word] = line  # the last such line selects the profile
            elif word == "set":
                name, _, value = rest.partition(" = ")
                sections.setdefault(section, {})[name] = value
            elif word == "mixer" and rest:
                mixer = rest
            elif word == "aux":
                slot, mode, channel, start, end, *_ = map(int, rest.split())
                if start < end:
                    ranges.append(ModeRange(mode, channel + _FIRST_AUX_CHANNEL, start, end))
                else:
                    free_slots.append(slot)
        values = sections[""] | sections.get(selected["profile"], {}) | sections.get(selected["rateprofile"], {})
        return cls(values, mixer, tuple(ranges), tuple(free_slots))

    def switches(self, modes: set[int], without: set[int]) -> list[int]:
        """Return the pulse widths (µs) of the channels from AUX1 on, with which some modes are active and others not.

        Args:
            modes: modes that must be active.
            without: modes that must not be active.

        Raises:
            InputError: if no positions of the switches activate these modes.
        """
        used = sorted({each.channel for each in self.mode_ranges})
        pulses = [_pulses_between_limits([each for each in self.mode_ranges if each.channel == i]) for i in used]
        best: tuple[int, tuple[float, ...]] | None = None
        for candidate in itertools.product(*pulses):
            by_channel = dict(zip(used, candidate, strict=True))
            active = {each.mode for each in self.mode_ranges if each.contains(by_channel[each.channel])}
            if modes <= active and not active & without and (best is None or len(active) < best[0]):
                best = len(active), candidate
        if best is None:
            wanted, unwanted = (join_names([_MODE_NAMES[each] for each in sorted(some)]) for some in (modes, without))
            raise InputError(
                f"laboratory.autopilot.settings: with its lines aux, no positions of the switches activate"
                f" {wanted or 'no mode'} without {unwanted}; give each mode a switch of its own"
            )
        pulse_of = dict(zip(used, best[1], strict=True))
        return [round(pulse_of.get(channel, LOW_PULSE)) for channel in range(_FIRST_AUX_CHANNEL, NUM_CHANNELS)]


def _pulses_between_limits(ranges: Sequence[ModeRange]) -> list[float]:
    """Return a pulse width (µs) in each interval between the limits of ranges of the same channel."""
    limits = {LOW_PULSE, _MAX_PULSE, *(limit for each in ranges for limit in (each.start, each.end))}
    ordered = sorted(limit for limit in limits if LOW_PULSE <= limit <= _MAX_PULSE)
    return [0.5 * (low + high) for low, high in itertools.pairwise(ordered)]


class Configuration(NamedTuple):
    """Configuration of the firmware, measured with the firmware itself.

    Attributes:
        file: content of the file with the settings.
        settings: settings.
        throttle_pulses: pulse widths of the throttle stick, µs.
        motor_commands: (21,) mean motor commands at these pulse widths while the vehicle rests; they do not decrease.
    """

    file: bytes
    settings: Settings
    throttle_pulses: np.ndarray
    motor_commands: np.ndarray


_configurations: ThreadSafeCache[Configuration] = ThreadSafeCache()


def configured(lines: Iterable[str]) -> Configuration:
    """Return the configuration of the firmware with settings, which is computed once per process.

    Args:
        lines: lines of the command line. Lines that describe the board are ignored.

    Raises:
        FirmwareError: if the firmware fails.
        ImportError: if Betaflight is not installed.
        InputError: if a line contains no command, the firmware refuses it, or cannot be armed with these settings.
    """
    flight_lines = tuple([line for line in map(str.strip, lines) if _affects_flight(line)])
    return _configurations.get(flight_lines, lambda: _configure(flight_lines))


def _affects_flight(line: str) -> bool:
    command, _, rest = line.partition(" ")
    if command == "set":
        return not rest.strip().lower().startswith(_BOARD_SETTINGS)
    if command and not command.startswith("#") and command not in (*_FLIGHT_COMMANDS, *_BOARD_COMMANDS):
        question = did_you_mean(command, _FLIGHT_COMMANDS)
        raise InputError(
            f"laboratory.autopilot.settings: {short_repr(line)} begins with no command of a Betaflight diff"
            f"{f'; {question}' if question else ''}"
        )
    return command in _FLIGHT_COMMANDS


def _configure(lines: Sequence[str]) -> Configuration:
    firmware = Betaflight()
    try:
        firmware.initialize()
        firmware.open_command_line()
        for line in lines:
            if error := _ERROR_PATTERN.search(firmware.command(line)):
                raise InputError(
                    f"laboratory.autopilot.settings: remove the line {short_repr(line)}, which Betaflight refuses:"
                    f" {error.group()}"
                )
        for line in _START_SETTINGS:
            firmware.command(line)
        settings = Settings.of(firmware.command("dump all"))
        for command in _missing_mode_commands(settings):
            firmware.command(command)
        settings = Settings.of(firmware.command("dump all"))
        file = firmware.saved_settings()
    finally:
        firmware.close()
    return Configuration(file, settings, _THROTTLE_PULSES, _motor_commands(file, settings))


def _missing_mode_commands(settings: Settings) -> list[str]:
    """Return the commands that assign switches to the modes ARM and ANGLE if they have none.

    Raises:
        InputError: if all switches or all numbers of `aux` are in use.
    """
    modes = [mode for mode in (ARM, ANGLE) if mode not in {each.mode for each in settings.mode_ranges}]
    free_channels = sorted({*range(_FIRST_AUX_CHANNEL, NUM_CHANNELS)} - {each.channel for each in settings.mode_ranges})
    if len(modes) > min(len(free_channels), len(settings.free_slots)):
        missing = join_names([_MODE_NAMES[mode] for mode in modes])
        raise InputError(
            f"laboratory.autopilot.settings: no switch is free for {missing}; remove a line aux, or assign a switch"
        )
    start, end = _SWITCH_RANGE
    return [
        f"aux {slot} {mode} {channel - _FIRST_AUX_CHANNEL} {start} {end} 0 0"
        for slot, mode, channel in zip(settings.free_slots, modes, free_channels, strict=False)
    ]


def _motor_commands(file: bytes, settings: Settings) -> np.ndarray:
    """Return the mean commands of the motors at the pulse widths of the throttle calibration."""
    firmware = armed(file, settings, is_angle_mode=True)
    try:
        means = []
        for pulse in _THROTTLE_PULSES:
            firmware.channels[THROTTLE] = round(pulse)
            means.append(np.mean(firmware.run(_SETTLING_TIME)))
    finally:
        firmware.close()
    commands: np.ndarray = np.maximum.accumulate(means)
    if not commands[-1] > commands[0]:
        raise InputError(
            "laboratory.autopilot.settings: the motor commands do not increase with the throttle stick; check the mixer"
            " and the throttle settings"
        )
    return commands


def armed(file: bytes, settings: Settings, *, is_angle_mode: bool) -> Betaflight:
    """Return a firmware that is armed on the ground, with the throttle stick down.

    Args:
        file: content of the file with the settings.
        settings: settings in this file.
        is_angle_mode: True for the angle mode, False for the acro mode.

    Raises:
        FirmwareError: if the firmware fails.
        InputError: if it cannot be armed.
    """
    modes, without = ({ANGLE}, {HORIZON}) if is_angle_mode else (set(), {ANGLE, HORIZON})
    firmware = Betaflight(file)
    try:
        firmware.initialize()
        firmware.channels[_FIRST_AUX_CHANNEL:] = settings.switches(modes, {*without, ARM})
        firmware.run(_CALIBRATION_TIME)
        firmware.channels[_FIRST_AUX_CHANNEL:] = settings.switches({*modes, ARM}, without)
        firmware.run(_ARMING_TIME)
        # The motors may stand still while the throttle stick is down.
        firmware.channels[THROTTLE] = _TEST_PULSE
        motors = firmware.run(_SETTLING_TIME)
        firmware.channels[THROTTLE] = LOW_PULSE
        if not any(motors):
            raise InputError(
                f"laboratory.autopilot.settings: Betaflight does not arm with these settings: {_arming_flags(firmware)}"
            )
    except BaseException:
        firmware.close()
        raise
    return firmware


def _arming_flags(firmware: Betaflight) -> str:
    """Return what the firmware prints about the reasons why it does not arm."""
    try:
        firmware.open_command_line()
        status = firmware.command("status")
    except FirmwareError as error:
        return str(error)
    return next((line for line in status.splitlines() if "Arming disable" in line), "the reason is unknown")
