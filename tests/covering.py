"""Selection of a small subset of cases that has every feature of the whole set."""

from collections.abc import Hashable, Mapping


def covering(features: Mapping[str, set[Hashable]]) -> list[str]:
    """Return the names of a few cases that together have every feature, chosen greedily.

    Args:
        features: set of features of each case, by the name of the case.
    """
    remaining, chosen = set().union(*features.values()), []
    while remaining:
        chosen.append(max(features, key=lambda name: len(features[name] & remaining)))
        remaining -= features[chosen[-1]]
    return chosen
