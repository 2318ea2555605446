"""Tests of the flight recorder."""

from drake_quad.assembly.recorder import build_recorder


def test_a_recorder_has_a_port_with_the_size_of_each_signal():
    recorder = build_recorder({"state": 12, "crashed": 2}, period=0.02)
    assert recorder.get_name() == "recorder"
    ports = [recorder.get_input_port(i) for i in range(recorder.num_input_ports())]
    assert [(port.get_name(), port.size()) for port in ports] == [("state", 12), ("crashed", 2)]
