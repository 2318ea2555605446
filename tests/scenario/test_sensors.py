"""Tests of sensors in scenarios: their attributes, and flights with shipped and user-defined sensors."""

import json
import pickle
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, closed_loop, load_scenario, read_flight, simulate, simulate_samples
from drake_quad.assembly.laboratory import laboratory_recipes
from drake_quad.flight.formats.mcap_file import flight_messages, flight_topics
from drake_quad.flight.mission import plan_route
from drake_quad.gym.vector_env import QuadrotorVectorEnv
from drake_quad.laboratory.sensors.accelerometer import ACCELEROMETER, AccelerometerParameters, SpecificForce
from drake_quad.laboratory.sensors.sensor import SensorLaw, with_errors
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.files.shipped import shipped_scenarios
from drake_quad.scenario.quantities import NonNegative
from drake_quad.scenario.schema import file_schema, language_page
from drake_quad.scenario.sensors.accelerometer import AccelerometerSettings
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings
from drake_quad.signals import SIGNALS, BodyRates, Charge, Number, Quantity, Row, State, Wind, sensor_port_name

SENSORS_OVERRIDE = (
    "laboratory.sensors=[{kind: accelerometer, position: [0.05, -0.03, 0.02], latency_samples: {choice: [0, 1, 3]},"
    " bias: [{uniform: {min: -0.2, max: 0.2}}, 0.1, 0], noise_density: {uniform: {min: 0.001, max: 0.01}}},"
    " {kind: accelerometer, period: 0.04}]"
)
WHOLE_FLIGHT_OVERRIDE = "metrics={start: 0, end: null}"


class Altitude(NamedTuple):
    """Reading of the altimeter: the height above the origin of W."""

    height: Annotated[Row, Quantity("m", "W")]


class AltimeterParameters(NamedTuple):
    """Parameters of the errors of an altimeter."""

    noise: Annotated[Row, Quantity("m")] = 0.0
    latency_samples: Number = 0.0


def altitude(parameters: AltimeterParameters, noise: Altitude | None, state: State, wind: Wind) -> Altitude:
    """Return the height minus an error caused by the dynamic pressure of a head wind."""
    height = state.z - 0.05 * wind.x * wind.x
    return Altitude(height if noise is None else height + parameters.noise * noise.height)


class AltimeterSettings(SensorSettings):
    """An altimeter."""

    kind: Literal["altimeter"]
    deviation: NonNegative = 0.0
    law: ClassVar = SensorLaw(Altitude, altitude, ("state", "wind"))
    noise: ClassVar = ("deviation",)

    def parameters(self, vehicle: Any) -> AltimeterParameters:
        return AltimeterParameters(self.deviation, self.latency_samples)


@pytest.fixture
def altimeter():
    """Register a user's kind of sensor during a test, and return it."""
    return SENSORS.register(AltimeterSettings)


def check_member(kind, name):
    """Assert that the system of a sensor has the ports and the noise that its settings declare."""
    vehicle = load_scenario("hover").vehicle
    exact = kind.model_validate({"kind": name})
    defaults = {field: kind.model_fields[field].default for field in kind.noise}
    noise = {field: [0.5] * len(value) if isinstance(value, tuple) else 0.5 for field, value in defaults.items()}
    imperfect = kind.model_validate({"kind": name, "latency_samples": 2.0} | noise)
    parameters = exact.parameters(vehicle)
    assert type(parameters)._field_defaults["latency_samples"] == parameters.latency_samples == 0.0
    for sensor, noisy in ((exact, False), (imperfect, True)):
        system = sensor.recipe(sensor, vehicle).build(2)
        assert [*system.random_inputs] == ["noise"] * noisy
        assert {update.period for update in system.updates} == {sensor.period}
        assert system.states[name].layout.kind is SIGNALS[name] is kind.law.reading
        assert system.num_input_ports() == len(kind.law.reads) + noisy
        for i in range(len(kind.law.reads)):
            assert system.get_input_port(i).get_name() == kind.law.reads[i]
        assert system.HasOutputPort(f"{name}_valid") == kind.law.can_miss
        assert system.num_output_ports() == 1 + kind.law.can_miss
    in_transit = {f"{name}_in_transit", *([f"{name}_valid", f"{name}_valid_in_transit"] if kind.law.can_miss else [])}
    assert system.states.keys() - {"memory"} == {name, *in_transit}


@pytest.mark.parametrize("name", SENSORS.members)
def test_declarations_of_every_kind_of_sensor_agree_with_its_system(name):
    check_member(SENSORS.get(name), name)


def test_a_user_s_sensor_is_checked_like_a_shipped_one(altimeter):
    check_member(altimeter, "altimeter")


@pytest.mark.long
@pytest.mark.parametrize(
    "scenario",
    [
        ("pid", "vehicle.linear_drag=0.3"),
        (
            "pid",
            "control.attitude=null",
            "laboratory.autopilot={kind: response, natural_frequency: [8, 7, 3], damping: [0.6, 0.7, 1.1]}",
            "vehicle.rotor_failure=null",
            "vehicle.centre_of_mass=[0, 0]",
        ),
    ],
    ids=["vehicle", "response"],
)
def test_sensor_readings_of_uncompiled_compiled_and_fleet_flights_agree(asymmetric, scenario):
    """The parameters are random. One sensor has a shorter period than the control, the other one a longer period."""
    random_scenario = asymmetric(scenario[0], *scenario[1:], SENSORS_OVERRIDE, WHOLE_FLIGHT_OVERRIDE, "duration=0.5")
    flights = assert_flown_alike(Batch.draw(random_scenario, range(3)))
    (single_flight,) = simulate_samples(random_scenario, [2])
    for name, values in single_flight.items():
        np.testing.assert_array_equal(values, flights[2][name], err_msg=name)
    assert np.ptp(flights[2]["accelerometer"], axis=0).min() > 0.01
    # The second sensor has a period of two ticks.
    second = flights[2]["accelerometer_2"]
    np.testing.assert_array_equal(second[1:-1:2], second[2::2])
    assert (second[2:-1:2] != second[3::2]).all()


@pytest.mark.long
def test_sensor_readings_of_uncompiled_and_compiled_flights_are_bit_identical():
    """The initial readings are not compared, since they are computed with the elementary functions of NumPy."""
    random_scenario = load_scenario("figure_eight", [SENSORS_OVERRIDE, "duration=0.5"])
    uncompiled, compiled = (
        simulate_samples(random_scenario, range(3), compiled=compiled) for compiled in (False, True)
    )
    for flight, expected in zip(compiled, uncompiled, strict=True):
        for name in ("state", *random_scenario.laboratory.named_sensors):
            np.testing.assert_array_equal(flight[name][1:], expected[name][1:], err_msg=name)


# Each kind of sensor with all its errors, and each kind of fault. The parameters of some errors are random.
EVERY_SENSOR = [
    {
        "kind": "accelerometer",
        "period": 0.02,  # equals the period of the recorded ticks
        "noise_density": 0.003,
        "bias_instability": 0.02,
        "bias_time": 0.3,
        "bias_random_walk": {"uniform": {"min": 0.01, "max": 0.02}},
        "scale_error": [0.01, -0.02, 0.03],
        "misalignment": [0.02, -0.03, 0.04],
        "bandwidth": 150.0,
        "temperature_coefficient": [0.01, 0.02, -0.01],
        "warm_up_rise": 10.0,
        "warm_up_time": 0.3,
        "full_scale": 9.9,
        "resolution": 0.0048,
        "position": [0.05, -0.03, 0.02],
        "vibration": {
            "unbalance": [1e-6, {"uniform": {"min": 1e-6, "max": 3e-6}}, 2e-6, 3e-6],
            "thrust_harmonics": [0.0, 0.01],
            "initial_phases": [0.1, 0.7, 1.9, 2.6],
        },
        "fault": {"kind": "dropout", "probability": 0.2},
    },
    {
        "kind": "gyroscope",
        "noise_density": 1e-4,
        "bias": [{"uniform": {"min": -0.01, "max": 0.01}}, 0.01, 0.0],
        "bias_instability": 1e-3,
        "vibration": {"unbalance": [2e-6, 1e-6, 3e-6, 2e-6]},
        "fault": {"kind": "frozen", "time": 0.35, "duration": 0.1},
    },
    {
        "kind": "barometer",
        "height_noise": 0.1,
        "drift": 0.3,
        "dynamic_pressure": 0.4,
        "ground_effect": 1.5,
        "latency_samples": 1,
    },
    {
        "kind": "magnetometer",
        "field_noise": 1e-7,
        "hard_iron": [1e-6, 2e-6, -1e-6],
        "soft_iron": [0.01, 0.02, 0.03, -0.01, 0.02, 0.01],
        "motor_interference": [1e-5, 0.0, 2e-5],
        "fault": {"kind": "dropout", "probability": {"choice": [0.1, 0.3]}, "time": 0.1},
    },
    {
        "kind": "gnss",
        "period": 0.04,
        "position_noise": [0.1, 0.1, 0.2],
        "velocity_noise": [0.05, 0.05, 0.1],
        "position_drift": [1.0, 1.0, 2.0],
        "multipath": [1.0, 1.0, 2.0],
        "multipath_time": 0.1,
        "latency_samples": 2,
        "fault": {"kind": "failed", "time": {"uniform": {"min": 0.1, "max": 0.3}}},
    },
    {"kind": "range_finder", "distance_noise": 0.01, "relative_noise": 0.01, "max_distance": 1.01},
    {"kind": "optical_flow", "flow_noise": 0.01, "scale_error": 0.05, "position": [0.02, 0.0, 0.0]},
    {"kind": "uwb_range", "anchor": [3.0, 0.0, 0.5], "distance_noise": 0.05, "outlier_rate": 0.2, "outlier_size": 0.5},
    {"kind": "uwb_range", "anchor": [0.0, 3.0, 0.5], "max_distance": 2.5},
]


@pytest.mark.long
def test_readings_of_all_kinds_of_sensors_agree_in_uncompiled_compiled_and_fleet_flights(asymmetric):
    sensors = f"laboratory.sensors={json.dumps(EVERY_SENSOR)}"
    random_scenario = asymmetric("pid", WHOLE_FLIGHT_OVERRIDE, "duration=0.5", sensors)
    flights = assert_flown_alike(Batch.draw(random_scenario, range(3)))
    (single_flight,) = simulate_samples(random_scenario, [2])
    assert {*random_scenario.laboratory.sensor_signals} <= single_flight.keys()
    for name, values in single_flight.items():
        np.testing.assert_array_equal(values, flights[2][name], err_msg=name)
    valid = flights[2]["accelerometer_valid"][:, 0]
    assert 0.5 < valid.mean() < 1.0
    np.testing.assert_array_equal(np.diff(flights[2]["accelerometer"][:, 0])[valid[1:] == 0.0], 0.0)


@pytest.mark.long
def test_sensors_do_not_change_the_flight(asymmetric):
    """Motion and random numbers are bit-identical. The file of a scenario without sensors does not mention them."""
    plain, sensing = (
        simulate(asymmetric("pid", WHOLE_FLIGHT_OVERRIDE, "duration=0.3", f"laboratory.sensors={sensors}"))
        for sensors in ("[]", "[{kind: accelerometer, noise_density: 0.01}]")
    )
    assert sensing.signals.keys() - plain.signals.keys() == {"accelerometer"}
    for name, values in plain.items():
        np.testing.assert_array_equal(values, sensing[name], err_msg=name)
    assert plain.metrics == sensing.metrics
    assert "sensors" not in plain.scenario.laboratory.model_dump()
    assert "sensors" in sensing.scenario.laboratory.model_dump()


def test_an_accelerometer_has_the_parameters_of_its_scenario(asymmetric):
    """The position is relative to the true centre of mass. The noise follows from the density and the period."""
    scenario = asymmetric("pid", SENSORS_OVERRIDE, "laboratory.sensors.1.noise_density=0.003", "vehicle.gravity=9.7")
    batch = Batch.draw(scenario, range(4))
    recipes = laboratory_recipes(batch, plan_route(scenario), 10.0)
    first, second = recipes["sensors.accelerometer"], recipes["sensors.accelerometer_2"]
    drawn_values = {path.removeprefix("laboratory.sensors.0."): values for path, values in batch.varying.items()}
    assert first.structure == {
        "name": "accelerometer",
        "law": ACCELEROMETER,
        "period": 0.01,
        "noisy": True,
        "longest_latency": 3,
        "errors": (),
        "fault": None,
    }
    parameters = first.parameters
    np.testing.assert_allclose(parameters.position, [0.05 + 0.0003, -0.03 - 0.0008, 0.02], rtol=1e-12)
    np.testing.assert_array_equal(parameters.bias.x, drawn_values["bias.0"])
    np.testing.assert_allclose(parameters.noise, drawn_values["noise_density"] / 0.1, rtol=1e-12)
    np.testing.assert_array_equal(parameters.latency_samples, drawn_values["latency_samples"])
    assert (parameters.bias.y, parameters.gravity) == (0.1, 9.7)
    assert second.structure["longest_latency"] == 0
    assert second.parameters.noise == pytest.approx(0.003 / 0.2)
    noiseless = Batch.draw(asymmetric("pid", SENSORS_OVERRIDE), range(4))
    with_noise = noiseless.with_varying({"laboratory.sensors.1.noise_density": np.full(4, 0.1)})
    for batch, noisy in ((noiseless, False), (with_noise, True)):
        recipe = laboratory_recipes(batch, plan_route(scenario), 10.0)["sensors.accelerometer_2"]
        assert recipe.structure["noisy"] == noisy
    default = AccelerometerSettings(kind="accelerometer")
    assert with_errors(default.parameters(load_scenario("hover").vehicle), ()) == AccelerometerParameters()


def hover(*sensors, **fields):
    return load_scenario("hover", {"duration": 0.3, "laboratory.sensors": [*sensors], **fields})


@pytest.mark.slow
def test_readings_of_a_user_s_sensor_are_recorded_and_read(altimeter, tmp_path):
    wind = [{"kind": "steady", "velocity": [2.0, 0.0, 0.0]}]
    sensor = {"kind": "altimeter", "latency_samples": 1}
    noisy = {"kind": "altimeter", "deviation": {"uniform": {"min": 0.1, "max": 0.2}}}
    scenario = hover(sensor, noisy, **{"laboratory.wind": wind})
    flights = assert_flown_alike(Batch.draw(scenario, range(3)))
    heights = flights[0].record("state").z
    np.testing.assert_allclose(flights[0].record("altimeter").height, heights - 0.05 * 4.0, atol=1e-12)
    # The noise of one vehicle is not a multiple of another vehicle's noise.
    errors = [flight.record("altimeter_2").height - heights + 0.2 for flight in flights[:2]]
    assert abs(np.corrcoef(*errors)[0, 1]) < 0.9
    flights[0].save(tmp_path)
    loaded_flight = read_flight(tmp_path)
    np.testing.assert_array_equal(loaded_flight["altimeter_2"], flights[0]["altimeter_2"])
    assert "altimeter_2.height (m)" in (tmp_path / "flight.csv").read_text(encoding="utf-8")
    schema = flight_topics("own", loaded_flight)["/own/signals/altimeter_2"]
    assert schema["properties"]["height"]["description"] == "m, along W"
    assert {"/own/signals/altimeter"} <= {message.topic for message in flight_messages("own", loaded_flight, 0)}


@pytest.mark.long
def test_a_user_s_sensor_is_part_of_the_language_while_it_is_registered(altimeter):
    assert "AltimeterSettings" in file_schema()["$defs"]
    assert "| `deviation` |" in language_page()
    scenario = hover({"kind": "altimeter", "deviation": 0.1})
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    with pytest.raises(InputError, match=r"laboratory.sensors.0.deviation is -1, but must be at least 0"):
        hover({"kind": "altimeter", "deviation": -1})
    SENSORS.remove("altimeter")
    assert "altimeter" not in SIGNALS
    with pytest.raises(InputError, match="laboratory.sensors.0.kind is 'altimeter', but must be one of"):
        hover({"kind": "altimeter"})
    SENSORS.register(altimeter)


def test_a_sensor_class_is_refused_if_attributes_are_missing_or_its_kind_is_taken(altimeter):
    class IncompleteSensor(SensorSettings):
        kind: Literal["incomplete"]
        noise: ClassVar = ()

    class SecondAccelerometer(altimeter):
        kind: Literal["accelerometer"]

    with pytest.raises(TypeError, match="IncompleteSensor must define law and parameters"):
        SENSORS.register(IncompleteSensor)
    with pytest.raises(ValueError, match="the name accelerometer of .* is taken by AccelerometerSettings"):
        SENSORS.register(SecondAccelerometer)
    for name in ("wind", "wind_2"):
        SecondAccelerometer.model_fields["kind"].annotation = Literal[name]
        with pytest.raises(ValueError, match=f"the kind {name} of .* is the name of an existing signal"):
            SENSORS.register(SecondAccelerometer)
    assert (SIGNALS["wind"], SIGNALS["accelerometer"]) == (Wind, SpecificForce)
    assert not any(name in SIGNALS for name in ("incomplete", "altimeter_", "altimeter_x"))
    assert [sensor_port_name("altimeter", number) for number in (1, 2, 12)] == [
        "altimeter",
        "altimeter_2",
        "altimeter_12",
    ]
    with pytest.raises(KeyError):
        SIGNALS["incomplete_2"]


def test_a_sensor_that_is_not_registered_is_refused(altimeter, monkeypatch):
    monkeypatch.setattr(altimeter, "law", SensorLaw(Charge, lambda parameters, noise, charge: charge, ("charge",)))
    with pytest.raises(
        InputError, match="the sensor altimeter needs the signal `charge`, but this laboratory provides only `state`, "
    ):
        simulate(hover({"kind": "altimeter"}))


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        ("period: 0.03", "laboratory.sensors.0.period is 0.03, but must be the shortest period, 0.01, times a power"),
        ("period: 0.005", "time_step is 0.01.*, but must not be .*, 0.005 s of laboratory.sensors.0.period"),
        ("noise_density: -0.1", "laboratory.sensors.0.noise_density is -0.1, but must be at least 0"),
        ("latency_samples: 0.5", "laboratory.sensors.0.latency_samples is 0.5, but must be a whole number"),
        ("fault: {kind: dropout, probability: 2}", "fault.probability is 2, but must be at least 0 and at most 1"),
        ("fault: {kind: broken}", "laboratory.sensors.0.fault.kind is 'broken', but must be"),
        ("vibration: {unbalance: [1.0, 0]}", "laboratory.sensors.0.vibration.unbalance"),
    ],
)
def test_a_sensor_with_invalid_settings_is_refused(sensor, words):
    with pytest.raises(InputError, match=words):
        load_scenario("hover", [f"laboratory.sensors=[{{kind: accelerometer, {sensor}}}]"])


@pytest.mark.slow
def test_sensors_do_not_change_linear_models():
    """No built-in control reads sensors, and slow sensors do not lengthen the period of a linear model."""
    sensors = {"kind": "accelerometer", "period": 0.08}, {"kind": "gyroscope", "bias_instability": 0.01}
    plain, sensing = closed_loop(hover()).system, closed_loop(hover(*sensors)).system
    np.testing.assert_array_equal(sensing.A, plain.A)
    assert (sensing.states, sensing.period) == (plain.states, plain.period)


@pytest.mark.long
@pytest.mark.parametrize("layer", [name for name in shipped_scenarios() if name.startswith("sensors/")])
def test_shipped_sensors_measure_hover_within_the_errors_of_their_data_sheets(layer):
    """Each sensor has a random bias. Bias and white noise are below six of their standard deviations."""
    flight = simulate(load_scenario("hover", ["duration=0.4", "sample=1"], layers=[layer]))
    assert {"gyroscope", "accelerometer"} <= {*flight.scenario.laboratory.named_sensors}
    rates, force = flight.record("gyroscope"), flight.record("accelerometer")
    assert np.abs(rates).max() < 6.0 * 0.0044 + 6.0 * 0.005
    assert np.ptp(rates.p) > 0.0
    np.testing.assert_allclose(np.array(force).mean(axis=1), [0.0, 0.0, 9.81], atol=0.05)
    for name in flight.scenario.laboratory.sensor_signals:
        if name.endswith("_valid"):
            assert flight[name].all()
    if "barometer" in flight.signals:
        assert np.abs(flight.record("barometer").height - 1.0).max() < 6.0 * 0.33
        np.testing.assert_allclose(flight.record("range_finder").distance, 1.0, atol=0.02)


class SpecificForceControl(LeafSystem):
    """Controller of the thrust alone, which keeps the specific force equal to gravity."""

    def __init__(self):
        super().__init__()
        self.force = self.DeclareVectorInputPort("accelerometer_2", BasicVector(3))
        self.DeclareVectorOutputPort("wrench", BasicVector(4), self.command)

    def command(self, context, output):
        output.SetFromVector([0.68 * 2.0 * (self.force.Eval(context)[2] - 4.905), 0.0, 0.0, 0.0])


def test_a_user_s_control_can_read_sensors():
    """If the command is twice the specific force minus half of gravity, hover is an equilibrium."""
    flight = simulate(
        hover({"kind": "accelerometer", "bias": [0, 0, 1]}, {"kind": "accelerometer"}), control=SpecificForceControl()
    )
    np.testing.assert_allclose(flight.record("wrench").thrust, 0.68 * 9.81, rtol=1e-9)
    with pytest.raises(
        InputError, match="control has the input port `accelerometer_2`, but may only have .*accelerometer`"
    ):
        simulate(hover({"kind": "accelerometer"}), control=SpecificForceControl())


@pytest.mark.slow
def test_gym_environments_provide_the_validity_and_the_readings_of_any_sensor():
    steps = []
    environments = QuadrotorVectorEnv(
        "hover",
        {
            "laboratory.sensors": [
                {"kind": "gyroscope", "noise_density": 1e-4, "vibration": {"unbalance": [1e-6, 0, 0, 0]}},
                {"kind": "gnss", "fault": {"kind": "failed"}},
            ]
        },
        num_envs=2,
        action="rates",
        signals=["gyroscope", "gnss", "gnss_valid"],
        reward=lambda step: steps.append(step.signals) or np.zeros(2),
    )
    environments.reset(seed=0)
    environments.step(np.zeros((2, 4)))
    (signals,) = steps
    assert isinstance(signals["gyroscope"], BodyRates)
    assert (signals["gyroscope"].p != 0.0).all()
    assert not signals["gnss_valid"].valid.any()
    assert not signals["gnss"].z.any()


@pytest.mark.slow
def test_gym_environments_provide_the_readings_of_sensors():
    forces = []
    environments = QuadrotorVectorEnv(
        "hover",
        {"laboratory.sensors": [{"kind": "accelerometer"}, {"kind": "accelerometer", "bias": [0.0, 0.0, 0.5]}]},
        num_envs=2,
        action="rates",
        signals=["accelerometer_2"],
        reward=lambda step: forces.append(step.signals["accelerometer_2"]) or np.zeros(2),
    )
    environments.reset(seed=0)
    environments.step(np.zeros((2, 4)))
    (force,) = forces
    assert isinstance(force, SpecificForce)
    assert (force.z > 0.5).all()
