"""Workers that do tasks in this process."""

from drake_quad.studies.worker_pool import run_task


class InventedWorkers:
    """Workers that do the last task that was begun first.

    Attributes:
        most: largest number of tasks that were under way at a time.
    """

    def __init__(self, capacity):
        self.capacity, self.under_way, self.most = capacity, [], 0

    def submit(self, function, given):
        self.under_way.append((function, given))
        self.most = max(self.most, len(self.under_way))

    def next_outcomes(self):
        return [run_task(*self.under_way.pop())]
