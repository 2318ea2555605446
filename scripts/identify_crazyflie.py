"""Identify a Crazyflie from a flight log, predict the logged motion, and simulate the flight with the result."""

from pathlib import Path

from drake_quad import compare_with_log, identify, load_scenario, load_undesigned, predict, read_log, write_vehicle

record = read_log(Path(__file__).parent.parent / "tests/data/crazyflie/crazyswarm2/log100.xz")
sheet = load_undesigned("vehicles/crazyflie", ["nominal.mass=0.0375"])  # the data sheet, with the weighed mass
result = identify([record], sheet, held_out_fraction=1.0 / 3.0)
print(result.estimates)

# Predictions start from logged states in the last third of the flight, and use logged commands. The estimates are based
# on the whole log, including this part.
predictions = predict(
    record, {"identified": result.vehicle, "data sheet": sheet}, nominal=sheet, final_fraction=1.0 / 3.0
)
for horizon in (0.1, 0.2, 0.5):
    error = predictions.rmse("position", "identified", horizon).text(unit="cm", size=0.01)
    improvement = predictions.error_reduction("position", "identified", "data sheet", horizon).percent()
    print(f"after {horizon} s: error {error}, {improvement} smaller than with the data sheet")

# 400 vehicles are drawn from the estimates, and fly with the controller and gains of the logged flight. Some of them
# oscillate and crash.
Path("out").mkdir(exist_ok=True)
path = write_vehicle(Path("out/identified.yaml"), "identified", result.estimates, base="crazyswarm2:sheet_100")
comparison = compare_with_log(record, load_scenario(path), samples=400)
median, low, _ = comparison.interval("rmse")
print(f"RMSE of the log {100.0 * comparison.logged_statistics.rmse[-1]:.2f} cm")
print(f"RMSE of 400 simulations: median {100.0 * median[-1]:.2f} cm, 2.5 % quantile {100.0 * low[-1]:.2f} cm")
print(f"crashed simulations: {comparison.crashes}")
