"""Order in which the operations of a formula are executed, by list scheduling.

Most lines of a formula use the result of the previous line. A processor looks ahead only by some dozens of
instructions, and would therefore wait for most results. The schedule is the order in which a processor with a much
larger window would execute the lines. Each line starts as soon as its operands are ready. If several lines are ready,
the first in the formula starts first.

    formula   a b c d e f     b uses a, and c uses b; e uses d, and f uses e
    schedule  a d b e c f     each line uses a result that is two lines old

The schedule does not change any result.
"""

from collections.abc import Mapping
from heapq import heappop, heappush
from types import MappingProxyType

from drake_quad.framework.machine_code import NUM_VECTOR_REGISTERS
from drake_quad.framework.symbols import LEAVES, Listing

# Number of lines, from the first unscheduled line on, among which the next line is selected. A larger window needs more
# registers. Other windows were measured for a tick with 8,800 lines. With 32 registers, a window of 300 lines was 4 %
# slower, and one of 1,000 lines was as fast. With 16 registers, a window of 60 lines was 2 % slower, and one of 400
# lines was 6 % slower.
_WINDOW = 600 if NUM_VECTOR_REGISTERS > 16 else 150
# Largest number of lines of a formula that a processor starts in one cycle.
_LINES_PER_CYCLE = 3
# Latencies in cycles on AMD's Zen 4 (A. Fog, "Instruction tables"). The latency of all other instructions is one cycle.
# A number and its bits share a register, so their conversion takes no time. The result of a comparison is written to a
# mask register: without this latency in the schedule, a tick with some arctangents was 15 % slower for one vehicle.
_LATENCIES = {
    **dict.fromkeys(("float_bits", "number_of"), 0),
    **dict.fromkeys(("add", "subtract", "nearest", "multiply"), 3),
    "multiply_add": 4,
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal", "equal", "not_equal", "sign_bit"), 5),
    "divide": 13,
    "square_root": 20,
}


def schedule(listing: Listing, operands: Mapping[int, tuple[int, ...]] = MappingProxyType({})) -> list[int]:
    """Return the line numbers in scheduled order; each line comes after its operands.

    Args:
        listing: listing of operations.
        operands: operands of lines that use more rows than the operands of their operations.
    """
    operations = listing.operations
    lines = [line for line, operation in enumerate(operations) if operation.name not in LEAVES]
    latencies = [_LATENCIES.get(operation.name, 1) for operation in operations]
    users: list[list[int] | None] = [None] * len(operations)
    for line in lines:
        users[line] = []
    num_missing, ready_cycle = [0] * len(operations), [0] * len(operations)
    for line in lines:
        for operand in {*operands.get(line, operations[line].operands)}:
            operand_users = users[operand]
            if operand_users is not None:
                operand_users.append(line)
                num_missing[line] += 1
    ready = [line for line in lines if not num_missing[line]]  # a sorted list is also a heap
    waiting: list[tuple[int, int]] = []
    order: list[int] = []
    is_scheduled = bytearray(len(operations))
    cycle, first, count = 0, 0, len(lines)
    while first < count:
        while waiting and waiting[0][0] <= cycle:
            heappush(ready, heappop(waiting)[1])
        room, last = _LINES_PER_CYCLE, lines[min(first + _WINDOW, count) - 1]
        while ready and room and ready[0] <= last:
            line = heappop(ready)
            order.append(line)
            is_scheduled[line] = True
            latency = latencies[line]
            room -= latency > 0
            done = cycle + latency
            for user in users[line] or ():
                num_missing[user] -= 1
                if ready_cycle[user] < done:
                    ready_cycle[user] = done
                if not num_missing[user]:
                    if ready_cycle[user] > cycle:
                        heappush(waiting, (ready_cycle[user], user))
                    else:
                        heappush(ready, user)
        while first < count and is_scheduled[lines[first]]:
            first += 1
        cycle += 1
    return _with_leaves(listing, order, operands)


def _with_leaves(listing: Listing, order: list[int], operands: Mapping[int, tuple[int, ...]]) -> list[int]:
    """Insert constants and rows into a schedule, each before the first line that uses it; append unused ones."""
    operations = listing.operations
    complete: dict[int, None] = {}
    for line in order:
        for operand in operands.get(line, operations[line].operands):
            complete[operand] = None
        complete[line] = None
    complete.update(dict.fromkeys(range(len(operations))))
    return list(complete)
