import numpy as np

from drake_quad.control.position import ProportionalDerivative, build_position_controller

K_P, K_D = np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.6, 0.7])
MEASUREMENT = np.arange(12.0) / 10.0
REFERENCE = np.arange(11.0)[::-1] / 3.0


def signals(num_vehicles=1, **options):
    pd = ProportionalDerivative(num_vehicles=num_vehicles, k_p=K_P, k_d=K_D, **options)
    diagram = build_position_controller(pd)
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("measurement").FixValue(context, np.repeat(MEASUREMENT, num_vehicles))
    diagram.GetInputPort("reference").FixValue(context, np.repeat(REFERENCE, num_vehicles))
    names = (diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports()))
    return {name: diagram.GetOutputPort(name).Eval(context).reshape(3, num_vehicles) for name in names}


def test_is_eq_8_on_the_tracking_error():
    result = signals()
    error, rate = REFERENCE[0:3] - MEASUREMENT[0:3], REFERENCE[3:6] - MEASUREMENT[6:9]
    np.testing.assert_allclose(result["error"][:, 0], error)
    np.testing.assert_allclose(result["error_rate"][:, 0], rate)
    np.testing.assert_allclose(result["pd"][:, 0], K_P * error + K_D * rate)
    np.testing.assert_allclose(result["correction"], 0.0)
    np.testing.assert_allclose(result["acceleration_command"], result["pd"])


def test_derivative_on_the_measurement():
    result = signals(derivative="measurement")
    np.testing.assert_allclose(result["error_rate"][:, 0], -MEASUREMENT[6:9])


def test_feed_forward_adds_the_reference_s_acceleration():
    result = signals(feed_forward=True)
    np.testing.assert_allclose(result["acceleration_command"][:, 0], result["pd"][:, 0] + REFERENCE[6:9])


def test_fleet_and_single_vehicle_agree():
    one, fleet = signals(feed_forward=True), signals(num_vehicles=3, feed_forward=True)
    for name, rows in fleet.items():
        np.testing.assert_array_equal(rows, np.repeat(one[name], 3, axis=1))
