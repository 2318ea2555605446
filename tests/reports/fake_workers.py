"""Stand-in for worker processes that runs tasks in this process."""

from drake_quad.studies.worker_pool import run_task


class FakeWorkers:
    """Stand-in for worker processes that completes the latest task first.

    Attributes:
        max_pending: largest number of tasks that were pending at the same time.
    """

    def __init__(self, capacity):
        self.capacity, self.pending, self.max_pending = capacity, [], 0

    def submit(self, function, argument):
        self.pending.append((function, argument))
        self.max_pending = max(self.max_pending, len(self.pending))

    def next_outcomes(self):
        return [run_task(*self.pending.pop())]
