"""Registration on a Ray cluster: the stages of ``scanweave describe``, ``pairs`` and ``register --pairs`` as tasks.

>>> import scanweave.ray                                                            # doctest: +SKIP
>>> result = scanweave.ray.register("/data/scans", output="/data/result")           # doctest: +SKIP

Needs Ray (``pip install "scanweave[ray]"``), and folders that all nodes see under the same paths. The result has
the bytes of one process. Through Ray go names of folders and settings, never points.
"""

from __future__ import annotations

import importlib
import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Optional, Union

from . import _scanweave as native
from ._api import ConfigLike
from ._api import config as settings_of
from ._errors import OutputError, ScanweaveError, input_error
from ._inputs import Inputs, gather
from ._progress import Progress, Reporter, reporter
from ._result import Result
from ._scanweave import Config

__all__ = ["register"]

_Path = Union[str, "os.PathLike[str]"]


@dataclass(frozen=True)
class _Job:
    """What every task is told."""

    scans: list[str]
    recursive: bool
    skip_unreadable: bool
    config: str
    seed: int
    #: Folder that relative paths start from.
    working_folder: str
    features: str
    pairs: str
    force: bool
    threads: int

    def settings(self) -> Config:
        return Config.from_toml(self.config, self.seed)

    def inputs(self, report: Optional[Reporter] = None) -> Inputs:
        return gather(self.scans, self.settings(), report, self.recursive, self.skip_unreadable)


_Task = Callable[[_Job, tuple[int, int]], None]


def register(
    scans: Union[_Path, Iterable[_Path]],
    *,
    output: _Path,
    shards: Optional[int] = None,
    config: ConfigLike = None,
    seed: Optional[int] = None,
    progress: Progress = False,
    force: bool = False,
    recursive: bool = False,
    skip_unreadable: bool = False,
    stages: Optional[_Path] = None,
    num_cpus: int = 1,
    memory: Optional[int] = None,
    max_retries: int = 3,
    max_in_flight: Optional[int] = None,
) -> Result:
    """Register scans on a Ray cluster, to the same bytes as :func:`scanweave.register` and the command.

    Features and the first pairs are computed by tasks, a shard each; the calling process joins them. A task
    whose worker dies is run again, and takes over what is in files already. So does a whole call that was
    stopped. Connects to the cluster that ``ray.init`` or ``RAY_ADDRESS`` names, else starts one on this machine,
    which ends with the call.

    Parameters
    ----------
    scans : path or list of paths
        Files, folders, patterns and ``@list.txt``, as the command takes them; every node must see them.
    output : path
        Folder for the result, as ``scanweave register`` writes it.
    shards : int, optional
        Parts that each stage is split into. Default: twice the tasks that run at a time, at most one a scan.
        The result is the same for every number.
    config, seed, progress, recursive, skip_unreadable
        As of :func:`scanweave.register`. Progress counts shards.
    force : bool
        Replace the result that the folder already holds, and files of stages with other scans or settings.
    stages : path, optional
        Folder for the files of the stages, which every node must see. Default: ``stages`` in the output folder.
    num_cpus : int
        CPUs, and threads, of a task.
    memory : int, optional
        Bytes of memory that Ray sets aside for a task; each holds all scans and the surfaces of all. Default:
        nothing is set aside.
    max_retries : int
        How often a task is run again after its worker died.
    max_in_flight : int, optional
        Tasks that are handed to Ray at a time. Default: as many as have CPUs.

    Returns
    -------
    Result

    Raises
    ------
    ImportError
        Without Ray.
    ScanweaveError
        Errors of the stages, as :func:`scanweave.register` raises them; workers that died too often.
    """
    ray = _ray()
    settings, report = settings_of(config, seed=seed), reporter(progress)
    native.check_shards(settings)
    counts = {"shards": shards, "num_cpus": num_cpus, "max_in_flight": max_in_flight}
    for name, value in counts.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
            raise input_error(name, repr(value), "a positive whole number", "pass another one, or leave it out")
    if not force and (Path(output) / "poses.json").exists():
        raise OutputError(f"{os.fspath(output)}: already holds a result; pass force=True to replace it")
    folder = Path(output) / "stages" if stages is None else Path(stages)
    own = not ray.is_initialized()
    if own:
        ray.init()
    try:
        limit = max_in_flight or max(1, int(ray.cluster_resources().get("CPU", 1) // num_cpus))
        paths = _paths(scans)
        # Before anything is computed: what cannot be read is known at once.
        inputs = gather(paths, settings, report, recursive, skip_unreadable)
        count = shards or max(1, min(len(inputs.given), 2 * limit))
        job = _Job(
            scans=paths,
            recursive=recursive,
            skip_unreadable=skip_unreadable,
            config=settings.to_toml(),
            seed=settings.seed,
            working_folder=os.getcwd(),
            features=str(folder / "features"),
            # Another number of shards is another set of files.
            pairs=str(folder / f"pairs-of-{count}"),
            force=force,
            threads=num_cpus,
        )
        options = {"num_cpus": num_cpus, "max_retries": max_retries, "memory": memory}
        for name, task in (("features", _describe), ("pairs", _register)):
            remote = ray.remote(**{k: v for k, v in options.items() if v is not None})(task)
            _run(ray, remote, name, job, (count, limit, max_retries), report)
    finally:
        if own:
            ray.shutdown()
    run = native.register(
        inputs.given, settings, inputs.initial_poses, None, (job.features, job.pairs), None, report
    )
    inputs.say(run.remarks)
    result = Result(run, inputs.remarks)
    result.save(output, force=force)
    return result


def _run(
    ray: Any,
    remote: Any,
    stage: str,
    job: _Job,
    numbers: tuple[int, int, int],
    report: Optional[Reporter],
) -> None:
    """All shards of a stage, no more than a limit of them at a time."""
    count, limit, max_retries = numbers
    running: dict[Any, int] = {}
    waiting = iter(range(count))
    if report is not None:
        report.begin(f"shards of {stage}", count)
    try:
        for _ in range(count):
            while len(running) < limit and (index := next(waiting, None)) is not None:
                running[remote.remote(job, (index, count))] = index
            (done, *_), _rest = ray.wait(list(running), num_returns=1)
            index = running.pop(done)
            try:
                ray.get(done)
            except ray.exceptions.RayTaskError as error:
                raise (error.cause if isinstance(error.cause, ScanweaveError) else error) from None
            except ray.exceptions.RayError as error:
                raise ScanweaveError(
                    f"stage {stage}, shard {index} of {count}: found a task that ended {max_retries + 1} times "
                    f"without a result ({str(error).splitlines()[0]}), expected workers that live; give a task "
                    "more memory, or run fewer at a time (max_in_flight)"
                ) from error
            if report is not None:
                report.advance(1)
    except BaseException:
        for task in running:
            ray.cancel(task, force=True)
        raise
    if report is not None:
        report.end()


def _describe(job: _Job, shard: tuple[int, int]) -> None:
    """The task of a shard of features."""
    with _within(job):
        given = job.inputs().given
        native.describe_shard(given, job.settings(), job.features, shard, job.force, job.threads, None)


def _register(job: _Job, shard: tuple[int, int]) -> None:
    """The task of a shard of pairs."""
    with _within(job):
        given, settings = job.inputs().given, job.settings()
        native.register_shard(given, settings, job.features, job.pairs, shard, job.force, job.threads, None)


@contextmanager
def _within(job: _Job) -> Iterator[None]:
    """Relative paths mean what they mean to the caller, who is told what is odd about scans once."""
    before = os.getcwd()
    os.chdir(job.working_folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        os.chdir(before)


def _paths(scans: Union[_Path, Iterable[_Path]]) -> list[str]:
    """The scans, which tasks read themselves."""
    listed: list[Any] = [scans] if isinstance(scans, (str, os.PathLike)) else list(scans)
    for scan in listed:
        if not isinstance(scan, (str, os.PathLike)):
            found = f"an object of {type(scan).__module__}.{type(scan).__qualname__}"
            remedy = "write the scans into files, or use scanweave.register"
            raise input_error("scans", found, "paths, which all nodes of the cluster see", remedy)
    return [os.fspath(scan) for scan in listed]


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise ImportError('scanweave.ray needs Ray: pip install "scanweave[ray]"') from error
