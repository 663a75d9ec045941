"""The functions of the package."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from typing import Any, Optional, Union

from . import _scanweave as native
from ._errors import input_error
from ._inputs import ScanLike, ScansLike, gather, one
from ._outcomes import evidence_of
from ._progress import Progress, reporter
from ._records import Features, Overlap, RegisteredPair, SyntheticScans
from ._result import Result
from ._scanweave import Config, Scan

#: Settings: a preset's name, a TOML file, a dictionary (nested, or with dots in its keys), or a Config.
ConfigLike = Union[Config, str, "os.PathLike[str]", Mapping[str, Any], None]

PRESETS = ("default", "paper")


def config(settings: ConfigLike = None, *, preset: str = "default", seed: Optional[int] = None) -> Config:
    """Effective settings, checked.

    Parameters
    ----------
    settings : dict, path, str or Config, optional
        Settings laid over the preset: ``{"scale.voxel_m": 0.05}``, ``{"scale": {"voxel_m": 0.05}}``, or a
        TOML file as ``--config`` takes it. A string that is the name of a preset is that preset.
        ``scanweave config`` prints every setting.
    preset : str
        ``"default"`` or ``"paper"``.
    seed : int, optional
        Seed of all randomness; the same as the setting ``seed``.

    Raises
    ------
    SettingError
        A setting that is unknown or cannot be used; the message names the nearest one known.
    """
    if seed is not None and (isinstance(seed, bool) or not 0 <= seed < 2**63):
        raise input_error("seed", repr(seed), "a whole number from 0 to 2^63 - 1", "pass another seed")
    if isinstance(settings, Config):
        if seed is None or seed == settings.seed:
            return settings
        return Config.from_toml(settings.to_toml(), int(seed))
    if isinstance(settings, str) and settings in PRESETS:
        return Config(settings, None, None, seed)
    if isinstance(settings, (str, os.PathLike)):
        return Config(preset, os.fspath(settings), None, seed)
    if settings is None:
        return Config(preset, None, None, seed)
    if isinstance(settings, Mapping):
        return Config(preset, None, dict(settings), seed)
    found = f"an object of {type(settings).__qualname__}"
    raise input_error("config", found, "a preset, a TOML file or a dictionary", "see scanweave.config")


def register(
    scans: ScansLike,
    *,
    config: ConfigLike = None,
    seed: Optional[int] = None,
    progress: Progress = False,
    threads: Optional[int] = None,
    cache: Union[str, os.PathLike[str], None] = None,
    recursive: bool = False,
    skip_unreadable: bool = False,
) -> Result:
    """Register unordered, partially overlapping scans.

    Every scan is either placed, with a pose and the evidence for it, or declined, with the reason why.
    The same scans, settings and seed give the same poses as the command ``scanweave register``, on any
    number of threads. Other threads of Python run meanwhile; Ctrl-C stops after the current item.

    Parameters
    ----------
    scans : list, dict or path
        Scans in any order. Each is

        - an array of shape (n, 3), single or double precision, of any strides: coordinates in metres in
          the frame of the scan. It is read in place and copied once, into the library's own memory;
        - a path, or a :class:`Scan` of :func:`read_scan`;
        - a dictionary with ``points`` and, where they are known, ``colors`` (n, 3), uint8 or floats from 0
          to 1; ``normals`` (n, 3), kept with the scan; ``viewpoint`` (3,), the place of the sensor in the
          frame of the points; ``initial_pose`` (4, 4), a rough ``world_from_scan`` that is then weighed as
          one (setting ``registration.prior``); ``name``;
        - a point cloud of Open3D, or a point cloud or mesh of trimesh.

        A dictionary of names and scans names them; others are called ``scan_0``, ``scan_1``, … by their
        place, or after their files. A string or a list of strings alone is what the command takes: files,
        folders, patterns and ``@list.txt``, naturally sorted.
    config : dict, path, str or Config, optional
        Settings, see :func:`scanweave.config`.
    seed : int, optional
        Seed of all randomness. Default: that of the settings, 0.
    progress : bool or function
        Bars by tqdm where it is installed; or a function called with stage, items done and their number.
    threads : int, optional
        Threads to use. Default: one a core. The result is the same for every number.
    cache : path, optional
        Folder where features and registered pairs are kept for the next call.
    recursive, skip_unreadable : bool
        Look into folders of folders; go on without files that cannot be read.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        Scans that cannot be used, among them fewer than two. A scan that fits nothing is no error.
    ReadError
        A file that cannot be read.
    SettingError
        Settings that cannot be used.
    KeyboardInterrupt
        After Ctrl-C.

    Examples
    --------
    >>> import scanweave
    >>> room = scanweave.synthetic_interior(scans=4, rooms=1)
    >>> result = scanweave.register(room.scans, seed=0)
    >>> len(result.poses)
    4
    """
    settings, report = _settings(config, seed), reporter(progress)
    inputs = gather(scans, settings, report, recursive, skip_unreadable)
    place = None if cache is None else os.fspath(cache)
    given, weighed = inputs.given, inputs.initial_poses
    run = native.register(given, settings, weighed, place, None, _threads(threads), report)
    inputs.say(run.remarks)
    return Result(run, inputs.remarks)


def register_pair(
    target: ScanLike,
    source: ScanLike,
    *,
    config: ConfigLike = None,
    seed: Optional[int] = None,
    progress: Progress = False,
    threads: Optional[int] = None,
) -> RegisteredPair:
    """Register one scan with another.

    Parameters
    ----------
    target, source : array, path, dict, Scan, Open3D or trimesh object
        As those of :func:`register`.
    config, seed, progress, threads
        As of :func:`register`.

    Returns
    -------
    RegisteredPair
    """
    settings = _settings(config, seed)
    given = one(target, "target", settings), one(source, "source", settings)
    report = reporter(progress)
    motion, accepted, found, reason = native.register_pair(*given, settings, _threads(threads), report)
    evidence = evidence_of(json.loads(found))
    return RegisteredPair(motion, accepted, evidence, evidence.probability, reason)


def describe(
    scans: ScansLike,
    *,
    config: ConfigLike = None,
    seed: Optional[int] = None,
    progress: Progress = False,
    threads: Optional[int] = None,
) -> dict[str, Features]:
    """Keypoints and local descriptors of scans that belong together.

    The lengths that they are computed at are chosen from all scans, as in a registration of them.

    Parameters
    ----------
    scans, config, seed, progress, threads
        As of :func:`register`.

    Returns
    -------
    dict of str to Features
        By the name of the scan.
    """
    settings, report = _settings(config, seed), reporter(progress)
    inputs = gather(scans, settings, report)
    names = inputs.names
    described = native.describe(inputs.given, settings, _threads(threads), report)
    return {name: Features(*arrays) for name, arrays in zip(names, described)}


def predict_overlap(
    scans: ScansLike,
    *,
    config: ConfigLike = None,
    seed: Optional[int] = None,
    progress: Progress = False,
    threads: Optional[int] = None,
) -> Overlap:
    """How much every two scans probably overlap, before any pair is registered.

    Parameters
    ----------
    scans, config, seed, progress, threads
        As of :func:`register`.

    Returns
    -------
    Overlap
    """
    settings, report = _settings(config, seed), reporter(progress)
    inputs = gather(scans, settings, report)
    names = inputs.names
    return Overlap(names, native.predict_overlap(inputs.given, settings, _threads(threads), report))


def read_scan(path: Union[str, os.PathLike[str]], *, config: ConfigLike = None) -> Scan:
    """Read the scan of a file of any format that the command reads.

    Parameters
    ----------
    path : path
        A file with one scan.
    config : dict, path, str or Config, optional
        What the file does not say itself, for example ``{"input.unit_m": 0.001}``.

    Returns
    -------
    Scan
        With ``name``, ``file``, ``points`` (n, 3) in metres, ``colors``, ``viewpoint``, ``initial_pose``.
    """
    scans = read_scans([path], config=config)
    if len(scans) != 1:
        found = f"{len(scans)} scans in {os.fspath(path)}"
        raise input_error("path", found, "a file with one scan", "use scanweave.read_scans")
    return scans[0]


def read_scans(
    paths: Union[Iterable[Union[str, os.PathLike[str]]], str, os.PathLike[str]],
    *,
    config: ConfigLike = None,
    progress: Progress = False,
    recursive: bool = False,
    skip_unreadable: bool = False,
) -> list[Scan]:
    """Read every scan of files, folders, patterns and ``@list.txt``, naturally sorted.

    Parameters
    ----------
    paths : path or list of paths
        As the command takes them.
    config, progress, recursive, skip_unreadable
        As of :func:`register`.

    Returns
    -------
    list of Scan
    """
    inputs = gather(paths, _settings(config, None), reporter(progress), recursive, skip_unreadable)
    return [scan for scan, _ in inputs.given]


def synthetic_interior(
    scans: int = 8, *, rooms: int = 1, unrelated: int = 0, noise: float = 1.0, seed: int = 0
) -> SyntheticScans:
    """Scan a synthetic interior with a depth camera, to try things on.

    Parameters
    ----------
    scans : int
        Scans taken in the building.
    rooms : int
        Rooms of the building.
    unrelated : int
        Scans of other buildings mixed in.
    noise : float
        Factor on the noise of the camera: 0 is exact, 1 like the first Kinect.
    seed : int
        The same seed gives the same scans.
    """
    made, poses, of_building = native.synthesize(scans, rooms, unrelated, noise, seed)
    truth = {scan.name: pose for scan, pose in zip(made, poses)}
    return SyntheticScans(made, truth, [s.name for s, own in zip(made, of_building) if not own])


def _settings(settings: ConfigLike, seed: Optional[int]) -> Config:
    return config(settings, seed=seed)


def _threads(threads: Optional[int]) -> Optional[int]:
    if threads is not None and (isinstance(threads, bool) or not 1 <= threads <= 65535):
        raise input_error("threads", repr(threads), "a number from 1 to 65535", "leave it out")
    return threads
