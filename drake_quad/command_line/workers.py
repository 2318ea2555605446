"""Options for the workers that fly many samples, and the pools of these workers."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from drake_quad.command_line.options import add_wired
from drake_quad.errors import InputError
from drake_quad.studies.cluster import dask_pool
from drake_quad.studies.processes import Workers
from drake_quad.studies.worker_pool import WorkerPool


def add_workers(options: argparse.ArgumentParser, *, task: str) -> None:
    """Add the options for workers, diagrams, and the resumption of a command that was interrupted.

    Args:
        options: options of a command.
        task: noun for what the command continues, such as "study".
    """
    options.add_argument("--workers", type=int, help="number of worker processes (default: number of cores)")
    options.add_argument(
        "--time-limit",
        type=float,
        metavar="SECONDS",
        help="computing time after which a batch is abandoned (default: no limit)",
    )
    options.add_argument(
        "--cluster", metavar="ADDRESS", help="address of a Dask scheduler, whose workers fly the samples"
    )
    add_wired(options)
    options.add_argument(
        "--resume", action="store_true", help=f"continue the {task} in the output folder, if there is one"
    )


@contextmanager
def open_executor(arguments: argparse.Namespace) -> Iterator[WorkerPool]:
    """Open the workers that fly the batches: processes on this machine, or the workers of a Dask cluster."""
    if arguments.cluster is None:
        with Workers(arguments.workers, time_limit=arguments.time_limit) as workers:
            yield workers
    elif arguments.time_limit is not None:
        raise InputError("--time-limit works for processes on this machine only; leave it out with --cluster")
    else:
        with dask_pool(arguments.cluster, arguments.workers) as pool:
            yield pool
