"""Selection of few cases that together have all features of many cases."""

from collections.abc import Hashable, Mapping


def covering(features: Mapping[str, set[Hashable]]) -> list[str]:
    """Return names of cases, chosen greedily, that together have every feature of all cases."""
    left, chosen = set().union(*features.values()), []
    while left:
        chosen.append(max(features, key=lambda name: len(features[name] & left)))
        left -= features[chosen[-1]]
    return chosen
