"""The replication: the paper's experiment flown again, and its claims judged by the numbers."""
