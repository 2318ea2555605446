"""Identify a Crazyflie from a flight log, predict the log with the result, and fly the reference of the log again."""

from pathlib import Path

from drake_quad import compare_with_log, identify, load_scenario, load_undesigned, predict, read_log, write_vehicle

# This scenario has the vehicle of the data sheet, with the mass and the gains of the flown vehicle.
SHEET = "crazyswarm2:sheet_100"

record = read_log(Path(__file__).parent.parent / "tests/data/crazyflie/crazyswarm2/log100.xz")
sheet = load_undesigned(SHEET)
found = identify([record], sheet, held_out_share=1.0 / 3.0)
print(found.estimates)

# The prediction starts from the logged state and takes the logged commands, in the last third of the flight,
# which the final fit has used as well.
ahead = predict(record, {"identified": found.vehicle, "sheet": sheet}, believed=sheet, share=1.0 / 3.0)
for horizon in (0.1, 0.2, 0.5):
    off = ahead.rmse("position", "identified", horizon).text(unit="cm", size=0.01)
    less = ahead.better("position", "identified", "sheet", horizon).percent()
    print(f"after {horizon} s: {off} off, {less} less than the data sheet")

# The controller that flew the log flies 400 vehicles that are drawn from the estimates. Some oscillate and crash.
Path("out").mkdir(exist_ok=True)
path = write_vehicle(Path("out/identified.yaml"), "identified", found.estimates, base=SHEET)
again = compare_with_log(record, load_scenario(path), samples=400)
median, low, _ = again.interval("rmse")
print(f"RMSE flown {100.0 * again.flown_figures.rmse[-1]:.2f} cm")
print(
    f"flown again {100.0 * median[-1]:.2f} cm in the median, at least {100.0 * low[-1]:.2f} cm; {again.crashes} crash"
)
