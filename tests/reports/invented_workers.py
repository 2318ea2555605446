"""Workers that do tasks in this process."""

from drake_quad.studies.crew import attempt


class InventedWorkers:
    """Workers that do the last task that was begun first.

    Attributes:
        most: largest number of tasks that were under way at a time.
    """

    def __init__(self, capacity):
        self.capacity, self.under_way, self.most = capacity, [], 0

    def begin(self, function, given):
        self.under_way.append((function, given))
        self.most = max(self.most, len(self.under_way))

    def finished(self):
        return [attempt(*self.under_way.pop())]
