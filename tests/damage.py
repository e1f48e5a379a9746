"""Records and files as a careless program or a stranger might leave them: valid ones, changed."""

import copy
import random

from mbtl.errors import MbtlError

VALUES = [
    *(None, True, False, 0, -1, 3, 10**9, 10**400, 0.5, -1e308, 1e308, float("nan"), float("inf")),
    *("", "a", "0", "..", "/etc/passwd", "../../x", "C:\\x", "a/../../b", "x\0y", "\ud800"),
    "é" * 300,
    *([], [0], [[0.0, 1.0]], ["a", "a"], {}, {"a": 1}, [None] * 5, [10**400], [{}] * 5),
]  # fmt: skip


def places(record, path=()):
    """Every key and index of a JSON-like record, as the way to it."""
    items = record.items() if isinstance(record, dict) else enumerate(record)
    for key, value in list(items):
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*path, key))


def damaged(record, seed):
    """A copy of a JSON-like record with one or two entries lost, replaced or repeated."""
    rng = random.Random(seed)
    record = copy.deepcopy(record)
    for _ in range(rng.choice([1, 1, 2])):
        known = list(places(record))
        if not known:
            return {"more": rng.choice(VALUES)}
        *way, last = rng.choice(known)
        there = record
        for key in way:
            there = there[key]
        change = rng.choice(["lose", "replace", "replace", "replace", "repeat"])
        if change == "lose":
            del there[last]
        elif change == "replace":
            there[last] = copy.deepcopy(rng.choice(VALUES))
        elif isinstance(there, list):
            there.append(copy.deepcopy(there[last]))
        else:
            there[f"{last}2"] = there[last]
    return record


def damaged_bytes(content, seed):
    """A copy cut short, or with a few bytes changed."""
    rng = random.Random(seed)
    changed = bytearray(content)
    if rng.random() < 0.3:
        return bytes(changed[: rng.randrange(len(changed))])
    for _ in range(rng.choice([1, 2, 8])):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


def refusals(attempt, seeds):
    """Of how many seeds `attempt(seed)` ends in an error of ours; any other error is a failure."""
    refused = 0
    for seed in range(seeds):
        try:
            attempt(seed)
        except MbtlError as error:
            refused += bool(str(error))
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error!r}") from error
    return refused
