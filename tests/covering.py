"""Selection of a few cases that together have all features of many cases."""

from collections.abc import Hashable, Mapping


def covering(features: Mapping[str, set[Hashable]]) -> list[str]:
    """Return the names of cases, chosen greedily, that together have every feature."""
    remaining, chosen = set().union(*features.values()), []
    while remaining:
        chosen.append(max(features, key=lambda name: len(features[name] & remaining)))
        remaining -= features[chosen[-1]]
    return chosen
