"""The report of the replication, as Markdown."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files

import numpy as np

from drake_quad.flight.mission import plan_route
from drake_quad.replication.assumptions import assumptions
from drake_quad.replication.calibration import HYPOTHESES, NETWORK_CELL, PD_CELL
from drake_quad.replication.claims import Claim
from drake_quad.replication.effort import EffortMatch, printed_ratios, printed_scatter
from drake_quad.replication.fair import COMPARED, FairEntry
from drake_quad.replication.findings import Findings
from drake_quad.replication.measures import EFFORTS, OUR_EFFORT
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, printed_table
from drake_quad.replication.results import Experiment
from drake_quad.replication.table_ii import QUANTITIES, Entry, table_markdown
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.report import image, table
from drake_quad.studies.statistics import Interval, compare_studies

FIGURES = {
    "table_ii": "RMSE of Table II: printed runs and their mean, and ours. The intervals of our means are narrower than"
    " their marks; the bars hold 95 % of the samples.",
    "figure_4": "The paper's Fig. 4: upper and lower elliptic memberships for four pairs of exponents.",
    "figure_7": "The paper's Fig. 7: the path without wind, sample 0; the numbers are those of the segments.",
    "figure_8": "The paper's Fig. 8: the same from above.",
    "figure_9": "The paper's Fig. 9: Euclidean error without wind, sample 0, over the numbered segments; triangles: the"
    " peaks that the paper's figure shows.",
    "figure_10": "The paper's Fig. 10: the same in low wind, four controllers; triangles: the mean RMSE of Table II.",
    "figure_11": "The paper's Fig. 11: the same in high wind.",
    "figure_12": "The paper's Fig. 12: what PD and network command on X, without wind.",
    "figure_13": "The paper's Fig. 13: the same on Y.",
    "advantage": "By how much the error of type 2 is smaller than that of type 1, without wind, over the noise of the"
    " cameras and over q, with 95 % intervals; where a point is below zero, type 1 is better.",
    "gains": "Mean RMSE over the gains of the PD, without wind; grey: a sample crashed.",
    "fair": "Mean RMSE of the PD and of PD+T2FNN beside controllers that the paper does not have.",
}


def report_markdown(found: Experiment, findings: Findings) -> str:
    """The whole report, which shows the figures of the folder `figures` beside it."""
    template = files(__package__).joinpath("report_template.md").read_text(encoding="utf-8")
    fields = {
        **_of_experiment(found),
        **_of_calibration(findings.calibration),
        **_of_table(findings.entries),
        **_of_claims(findings.claims),
        **_of_fair(found, findings.fair),
        **_of_effort(findings.efforts),
        **{f"figure_{name}": _image(name) for name in ("table_ii", "fair")},
        "figures": "\n\n".join(_image(name) for name in FIGURES if name.startswith("figure_")),
    }
    return template.format_map(fields)


def verdict_table(claims: Iterable[Claim]) -> str:
    """Claims with their evidence and verdicts, as a table in Markdown."""
    rows = [(claim.words, claim.printed, claim.ours, f"**{claim.verdict}**") for claim in claims]
    return table(("claim", "the paper's evidence", "ours, with 95 % intervals", "verdict"), rows)


def _of_experiment(found: Experiment) -> dict[str, str]:
    low_wind = found.cells[Cell("low_wind", "pd_t2fnn")].scenario
    sweeps = [found.noise, found.q, *found.slopes.values(), *found.maps.values()]
    varied = [*(sweep.metrics.crashed for sweep in sweeps), np.isnan(found.legs.metrics.straight)]
    path = {name: mean_interval(found.recorded[Cell("no_wind", name)]["path_error"]) for name in ("pd", "pd_t2fnn")}
    return {
        "samples": f"{len(found.cells[PD_CELL].samples):,}",
        "recorded": str(len(found.recorded[PD_CELL]["path_error"])),
        "legs": str(len(plan_route(low_wind).legs)),
        "duration": f"{found.cells[PD_CELL].duration:.1f}",
        "assumptions": table(("not said", "taken", "because"), assumptions(low_wind)),
        "path_pd": path["pd"].metres(),
        "path_network": path["pd_t2fnn"].metres(),
        "varied": f"{sum(crashed.size for crashed in varied):,}",
        "varied_crashed": f"{sum(int(crashed.sum()) for crashed in varied):,}",
        "sweep": str(len(found.noise.samples)),
    }


def _of_calibration(calibration: Mapping[str, np.ndarray]) -> dict[str, str]:
    printed = printed_table()
    errors = {
        (name, Cell(wind, controller)): float(error)
        for name, wind, controller, error in zip(
            *(calibration[column] for column in ("hypothesis", "wind", "controller", "rmse_m")), strict=True
        )
    }
    off = {key: error / printed[key[1]].rmse.mean - 1.0 for key, error in errors.items()}
    rows = []
    for cell, line in printed.items():
        ours = (f"{errors[name, cell]:.3f}{_in_brackets(off[name, cell])}" for name in HYPOTHESES)
        fitted = " (fitted)" if cell in _FITTED else ""
        rows.append((WINDS[cell.wind] + fitted, CONTROLLERS[cell.controller], _number(line.rmse.mean), *ours))
    numbers = []
    for name, hypothesis in HYPOTHESES.items():
        first = int(np.argmax(calibration["hypothesis"] == name))
        pd, network = (calibration[column][first] for column in ("pd_number", "network_number"))
        numbers.append(
            f"- {hypothesis.words}: {hypothesis.pd.words} {pd:.4g}; {hypothesis.network.words} {network:.4g}."
        )
    spreads = {}
    for name in HYPOTHESES:
        predicted = [
            100.0 * off[name, cell] for cell in printed if cell not in _FITTED and np.isfinite(off[name, cell])
        ]
        spreads[f"spread_{name}"] = f"{min(predicted):+.1f} to {max(predicted):+.1f} %"
    header = ("", "", "printed", *(hypothesis.words for hypothesis in HYPOTHESES.values()))
    return {"fitted": "\n".join(numbers), "calibration": table(header, rows), **spreads}


def _of_table(entries: Sequence[Entry]) -> dict[str, str]:
    errors = {entry.cell: entry for entry in entries if entry.quantity == "rmse"}
    predicted = [entry for cell, entry in errors.items() if cell not in _FITTED and np.isfinite(entry.off)]
    beyond = [entry for entry in predicted if abs(entry.off) > 0.1]
    offs = [entry.off for entry in predicted]
    crashed = sum(entry.crashed for entry in errors.values())
    return {
        **{f"table_{name}": table_markdown(entries, name) for name in QUANTITIES},
        "off_pd": f"{100.0 * errors[PD_CELL].off:+.1f} %",
        "off_network": f"{100.0 * errors[NETWORK_CELL].off:+.1f} %",
        "predicted": str(len(predicted)),
        "within": str(len(predicted) - len(beyond)),
        "beyond": "; not so " + ", ".join(map(_named, beyond)) if beyond else "",
        "spread": f"{100.0 * min(offs):+.1f} to {100.0 * max(offs):+.1f} %",
        "crashes": f"{crashed:,} samples crashed; means are those of the others." if crashed else "No sample crashed.",
    }


def _of_claims(claims: Sequence[Claim]) -> dict[str, str]:
    parts = []
    for number, claim in enumerate(claims, start=1):
        title = claim.words[0].upper() + claim.words[1:]
        parts.append(
            f"### {number}. {title}\n\nThe paper: {claim.printed}. Here: {claim.ours}.\n\nVerdict:"
            f" **{claim.verdict}**. Rule: {claim.rule}."
        )
        if claim.details:
            parts.append(f"Cell by cell: {claim.details}.")
        if claim.figure:
            parts.append(_image(claim.figure))
    count = Counter(claim.verdict for claim in claims)
    return {
        "verdicts": verdict_table(claims),
        "claims": "\n\n".join(parts),
        "count": ", ".join(f"{number} × {verdict}" for verdict, number in count.most_common()),
    }


def _of_fair(found: Experiment, entries: Sequence[FairEntry]) -> dict[str, str]:
    rows = [
        (
            WINDS[entry.cell.wind],
            COMPARED[entry.cell.controller],
            *(mean.text() for mean in (entry.rmse, entry.peak_error, entry.effort_x, entry.effort_y)),
            "1" if entry.cell.controller == "pd" else entry.over_pd.ratio(),
            "1" if entry.cell.controller == "pd_t2fnn" else entry.over_network.ratio(),
        )
        for entry in entries
    ]
    header = (
        "",
        "",
        "RMSE (m)",
        "peak error (m)",
        "effort on X (m²/s⁴)",
        "effort on Y (m²/s⁴)",
        "RMSE over PD's",
        "RMSE over PD+T2FNN's",
    )
    over_network = {entry.cell: entry.over_network for entry in entries}
    helped = {
        wind: compare_studies(
            found.cells[Cell(wind, "pd_feed_forward_t2fnn")], found.cells[Cell(wind, "pd_feed_forward")]
        ).share
        for wind in WINDS
    }
    return {
        "fair": table(header, rows),
        **{
            f"{name}_over_network": _by_wind({wind: over_network[Cell(wind, name)] for wind in WINDS})
            for name in ("pd_retuned", "pd_feed_forward")
        },
        "network_over_feed_forward": _by_wind(helped),
    }


def _of_effort(matches: Sequence[EffortMatch]) -> dict[str, str]:
    x, y = printed_ratios()
    rows = [("*printed*", f"{x:.2f}", f"{y:.2f}", "")]
    for match in matches:
        words = EFFORTS[match.name].words + (" (ours)" if match.name == OUR_EFFORT else "")
        rows.append((words, f"{match.ratio_x:.2f}", f"{match.ratio_y:.2f}", match.distance.ratio()))
    return {
        "effort": table(("definition", "ratio on X", "ratio on Y", "off by a factor of"), rows),
        "scatter": f"{printed_scatter():.2f}",
        "closest": f"the {EFFORTS[matches[0].name].words}",
    }


_FITTED = (PD_CELL, NETWORK_CELL)


def _named(entry: Entry) -> str:
    return f"{CONTROLLERS[entry.cell.controller]} in {WINDS[entry.cell.wind]} ({100.0 * entry.off:+.1f} %)"


def _image(name: str) -> str:
    return image(name, FIGURES[name])


def _by_wind(shares: Mapping[str, Interval]) -> str:
    return ", ".join(f"{share.percent()} ({WINDS[wind]})" for wind, share in shares.items())


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3f}"


def _in_brackets(off: float) -> str:
    return "" if np.isnan(off) else f" ({100.0 * off:+.1f} %)"
