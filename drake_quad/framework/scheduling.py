"""The order in which the lines of a listing are written.

A formula computes one thing from the one before, and the next formula begins where it ends. A processor that follows
them would wait for most results, since it looks only some dozens of instructions ahead. So the order is that of a
processor that looks much further: each line is written when what it takes is ready, the earliest of the formula first.

    formula  a b c d e f ...            a, b, c: each from the one before; d, e, f likewise
    written  a d . b e . c f            no line waits for the one above it

It changes when something is computed, and nothing of what is computed.
"""

from heapq import heappop, heappush

from drake_quad.framework.machine_code import REGISTERS
from drake_quad.framework.symbols import LEAVES, Listing

# Lines that are looked at, beginning with the first that is not written: fewer where registers are few, since more of
# them wait meanwhile. With 32 registers a tick of 8,800 lines takes 4 % longer if it is 300, as long if it is 1,000.
# With 16 it takes 2 % longer if it is 60, and 6 % if it is 400.
_WINDOW = 600 if REGISTERS > 16 else 150
# Lines that begin in a cycle.
_WIDTH = 3
# Latencies in cycles on AMD's Zen 4 (A. Fog, "Instruction tables"); all other instructions have a latency of one cycle.
# A number and its bits share a register. The result of a comparison goes to a mask register: if the schedule ignores
# its latency, a tick with some arctangents takes 15 % longer for one vehicle.
_LATENCY = {
    **dict.fromkeys(("bits_of", "number_of"), 0),
    **dict.fromkeys(("add", "subtract", "nearest", "multiply"), 3),
    "multiply_add": 4,
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal", "equal", "not_equal", "sign_bit"), 5),
    "divide": 13,
    "square_root": 20,
}


def scheduled(listing: Listing) -> list[int]:
    """The numbers of all lines, each after those that it takes; constants and rows before their first use."""
    operations = listing.operations
    lines = [line for line, operation in enumerate(operations) if operation.name not in LEAVES]
    latencies = [_LATENCY.get(operation.name, 1) for operation in operations]
    users: list[list[int] | None] = [None] * len(operations)
    for line in lines:
        users[line] = []
    missing, at = [0] * len(operations), [0] * len(operations)
    for line in lines:
        for operand in {*operations[line].operands}:
            own = users[operand]
            if own is not None:
                own.append(line)
                missing[line] += 1
    ready = [line for line in lines if not missing[line]]  # sorted, and so a heap
    waiting: list[tuple[int, int]] = []
    order: list[int] = []
    written = bytearray(len(operations))
    cycle, first, count = 0, 0, len(lines)
    while first < count:
        while waiting and waiting[0][0] <= cycle:
            heappush(ready, heappop(waiting)[1])
        room, last = _WIDTH, lines[min(first + _WINDOW, count) - 1]
        while ready and room and ready[0] <= last:
            line = heappop(ready)
            order.append(line)
            written[line] = True
            latency = latencies[line]
            room -= latency > 0
            done = cycle + latency
            for user in users[line] or ():
                missing[user] -= 1
                if at[user] < done:
                    at[user] = done
                if not missing[user]:
                    if at[user] > cycle:
                        heappush(waiting, (at[user], user))
                    else:
                        heappush(ready, user)
        while first < count and written[lines[first]]:
            first += 1
        cycle += 1
    return _with_leaves(listing, order)


def _with_leaves(listing: Listing, order: list[int]) -> list[int]:
    """The same order with constants and rows: each before what takes it first, or at the end if nothing does."""
    operations = listing.operations
    whole: dict[int, None] = {}
    for line in order:
        for operand in operations[line].operands:
            whole[operand] = None
        whole[line] = None
    whole.update(dict.fromkeys(range(len(operations))))
    return list(whole)
