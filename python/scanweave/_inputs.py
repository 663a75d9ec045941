"""From what people hold scans in to scans: arrays, files, dictionaries, Open3D and trimesh objects."""

from __future__ import annotations

import difflib
import os
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._errors import ScanweaveWarning, input_error
from ._progress import Reporter
from ._scanweave import Config, Scan, read

#: A scan: an ``[n, 3]`` array, a path, a :class:`Scan`, a dictionary, or an object of Open3D or trimesh.
ScanLike = Union[Scan, "NDArray[Any]", str, "os.PathLike[str]", Mapping[str, Any], Any]
#: Scans: a list of them, a dictionary of names and scans, or a folder, pattern or ``@list.txt``.
ScansLike = Union[Iterable[ScanLike], Mapping[str, ScanLike], str, "os.PathLike[str]"]

#: A scan, and whether it was made here, so that the call may take it.
Given = tuple[Scan, bool]

KEYS = ("points", "colors", "normals", "viewpoint", "initial_pose", "name")


class Inputs:
    """Scans as they go into a call."""

    def __init__(self) -> None:
        self.given: list[Given] = []
        self.remarks: list[str] = []
        #: Whether a dictionary stated a rough pose.
        self.initial_poses = False

    @property
    def names(self) -> list[str]:
        return [scan.name for scan, _ in self.given]

    def say(self, said: Iterable[tuple[bool, str]]) -> None:
        for is_warning, text in said:
            self.remarks.append(text)
            if is_warning:
                warnings.warn(text, ScanweaveWarning, stacklevel=4)


def gather(
    scans: ScansLike,
    config: Config,
    reporter: Optional[Reporter] = None,
    recursive: bool = False,
    skip_unreadable: bool = False,
) -> Inputs:
    """The scans, in order, each with a name of its own."""
    inputs = Inputs()
    if isinstance(scans, (str, os.PathLike)):
        scans = [scans]
    named = isinstance(scans, Mapping)
    if isinstance(scans, Mapping):
        if "points" in scans and not isinstance(scans["points"], Mapping):
            expected = "a list of scans, or a dictionary of names and scans"
            raise input_error("scans", "one scan as a dictionary", expected, "put it in a list, with others")
        items: list[tuple[Optional[str], Any]] = [(str(name), scan) for name, scan in scans.items()]
    elif _is_many(scans):
        items = [(None, scan) for scan in scans]
    else:
        found = f"an object of {_kind(scans)}"
        raise input_error("scans", found, "a list of scans or a path", "put the scans in a list")
    if not named and all(_is_path(scan) for _, scan in items):
        paths = [os.fspath(scan) for _, scan in items]
        files, said = read(paths, recursive, skip_unreadable, config, reporter)
        inputs.given = [(scan, True) for scan in files]
        inputs.say(said)
    else:
        for index, (name, item) in enumerate(items):
            _add(inputs, item, f"scans[{name!r}]" if named else f"scans[{index}]", name, index, config)
    _check_names(inputs.names)
    return inputs


def one(scan: ScanLike, argument: str, config: Config) -> Given:
    """A single scan that is passed as ``argument``."""
    inputs = Inputs()
    _add(inputs, scan, argument, None, 0, config, argument)
    return inputs.given[0]


def _add(
    inputs: Inputs,
    item: Any,
    subject: str,
    name: Optional[str],
    index: int,
    config: Config,
    usual_name: Optional[str] = None,
) -> None:
    if isinstance(item, Scan):
        inputs.given.append((item, False) if name is None else (item.renamed(name), True))
        return
    if _is_path(item):
        files, said = read([os.fspath(item)], False, False, config, None)
        if name is not None and len(files) == 1:
            files = [files[0].renamed(name)]
        elif name is not None or usual_name is not None:
            if len(files) != 1:
                found, expected = f"{len(files)} scans in {os.fspath(item)}", "one scan"
                raise input_error(subject, found, expected, "pass scans of read_scans(path) one by one")
        inputs.given.extend((scan, True) for scan in files)
        inputs.say(said)
        return
    parts = _parts(item, subject)
    stated = parts.get("name")
    chosen = name if name is not None else str(stated) if stated is not None else usual_name
    made = _made(parts, subject, chosen if chosen is not None else f"scan_{index}")
    inputs.initial_poses |= parts.get("initial_pose") is not None
    inputs.given.append((made, True))
    dropped = made.left_out[0]
    if dropped:
        inputs.say([(True, f"{subject}: left out {dropped} of {dropped + len(made)} points, not finite")])


def _parts(item: Any, subject: str) -> Mapping[str, Any]:
    """What an object holds, by the keys of a dictionary."""
    if isinstance(item, Mapping):
        for key in item:
            if key not in KEYS:
                near = difflib.get_close_matches(str(key), KEYS, n=1)
                remedy = f"did you mean {near[0]!r}?" if near else "leave it out"
                raise input_error(subject, f"the key {key!r}", f"keys among {', '.join(KEYS)}", remedy)
        if item.get("points") is None:
            raise input_error(subject, "no points", "the key 'points'", "pass an array of shape (n, 3)")
        return item
    for read_object in (_open3d_tensor, _open3d, _trimesh):
        parts = read_object(item)
        if parts is not None:
            return parts
    return {"points": item}


def _open3d(item: Any) -> Optional[dict[str, Any]]:
    """``open3d.geometry.PointCloud``, or whatever has points as it does."""
    points = getattr(item, "points", None)
    if points is None or callable(points) or isinstance(item, np.ndarray):
        return None
    parts: dict[str, Any] = {"points": points}
    for key in ("colors", "normals"):
        values = getattr(item, key, None)
        if values is not None and not callable(values) and len(values) == len(points):
            parts[key] = values
    return parts


def _open3d_tensor(item: Any) -> Optional[dict[str, Any]]:
    """``open3d.t.geometry.PointCloud``."""
    held = getattr(item, "point", None)
    if held is None or callable(held):
        return None
    try:
        parts = {"points": held["positions"]}
    except (KeyError, TypeError, IndexError, RuntimeError):
        return None
    for key in ("colors", "normals"):
        try:
            parts[key] = held[key]
        except (KeyError, IndexError, RuntimeError):
            continue
    return {key: tensor.numpy() if hasattr(tensor, "numpy") else tensor for key, tensor in parts.items()}


def _trimesh(item: Any) -> Optional[dict[str, Any]]:
    """``trimesh.PointCloud``, ``trimesh.Trimesh``, or whatever has vertices as they do."""
    vertices = getattr(item, "vertices", None)
    if vertices is None or callable(vertices):
        return None
    parts: dict[str, Any] = {"points": vertices}
    colors = getattr(item, "colors", None)
    if colors is None:
        colors = getattr(getattr(item, "visual", None), "vertex_colors", None)
    if colors is not None and np.shape(colors)[:1] == np.shape(vertices)[:1]:
        parts["colors"] = colors
    return parts


def _made(parts: Mapping[str, Any], subject: str, name: str) -> Scan:
    points = _coordinates(parts["points"], subject)
    colors = parts.get("colors")
    normals = parts.get("normals")
    viewpoint = parts.get("viewpoint")
    pose = parts.get("initial_pose")
    made = Scan(
        name,
        points,
        None if colors is None else _colors(colors, len(points), f"colors of {subject}"),
        None if normals is None else _normals(normals, len(points), f"normals of {subject}"),
        None if viewpoint is None else _viewpoint(viewpoint, f"viewpoint of {subject}"),
        None if pose is None else matrix(pose, f"initial_pose of {subject}"),
    )
    if len(made) == 0:
        found = f"no finite point of {len(points)}"
        raise input_error(subject, found, "at least one point with finite coordinates", "leave this scan out")
    return made


def numbers(value: Any, subject: str, expected: str) -> NDArray[Any]:
    """An array of numbers; single and double precision stay what they are."""
    try:
        array = np.asarray(value)
    except Exception as error:
        found = f"an object of {_kind(value)} that is no array ({error})"
        raise input_error(subject, found, expected, "pass a NumPy array") from error
    if array.dtype.names and {"x", "y", "z"} <= set(array.dtype.names):
        array = np.stack([array[axis].ravel() for axis in "xyz"], axis=1)
    if array.dtype.kind not in "fiu":
        found = f"an object of {_kind(value)}" if array.ndim == 0 else f"values of type {array.dtype}"
        raise input_error(subject, found, expected, "pass a NumPy array of numbers")
    if array.dtype.kind == "f" and array.dtype.itemsize in (4, 8):
        return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))
    return array if array.dtype == np.uint8 else array.astype(np.float64)


def _coordinates(value: Any, subject: str) -> NDArray[Any]:
    expected = "points of shape (n, 3), metres"
    array = numbers(value, subject, expected)
    if array.ndim == 3 and array.shape[2] == 3:
        remedy = "flatten it: points.reshape(-1, 3)"
        raise input_error(subject, f"an array of shape {array.shape}", expected, remedy)
    if array.ndim != 2 or array.shape[1] != 3:
        remedy = "pass points[:, :3]" if array.ndim == 2 and array.shape[1] > 3 else "reshape the array"
        raise input_error(subject, f"an array of shape {array.shape}", expected, remedy)
    if len(array) == 0:
        raise input_error(subject, "an array without a point", expected, "leave this scan out")
    return array.astype(np.float64) if array.dtype == np.uint8 else array


def _colors(value: Any, n: int, subject: str) -> NDArray[np.uint8]:
    expected = f"shape ({n}, 3), sRGB: uint8 from 0 to 255, or floats from 0 to 1"
    array = numbers(value, subject, expected)
    if array.ndim != 2 or array.shape[0] != n or array.shape[1] not in (3, 4):
        raise input_error(subject, f"an array of shape {array.shape}", expected, "pass one color a point")
    array = array[:, :3]
    if array.dtype == np.uint8:
        return array
    array = array.astype(np.float64)
    kind = np.asarray(value).dtype.kind
    most = 1.0 if kind == "f" else 255.0
    if not (np.isfinite(array).all() and array.min() >= 0 and array.max() <= most):
        found = f"values from {array.min():g} to {array.max():g}"
        raise input_error(subject, found, expected, "scale the colors, or leave them out")
    return np.rint(array * (255.0 / most)).astype(np.uint8)


def _normals(value: Any, n: int, subject: str) -> NDArray[np.float32]:
    expected = f"directions of shape ({n}, 3)"
    array = numbers(value, subject, expected)
    if array.shape != (n, 3):
        raise input_error(subject, f"an array of shape {array.shape}", expected, "pass one normal a point")
    return array.astype(np.float32)


def _viewpoint(value: Any, subject: str) -> tuple[float, float, float]:
    expected = "three finite coordinates of the sensor, metres, in the frame of the points"
    array = numbers(value, subject, expected)
    if array.shape != (3,):
        raise input_error(subject, f"an array of shape {array.shape}", expected, "pass [x, y, z]")
    if not np.isfinite(array).all():
        raise input_error(subject, f"{array.tolist()}", expected, "leave it out where it is not known")
    return float(array[0]), float(array[1]), float(array[2])


def matrix(value: Any, subject: str) -> NDArray[np.float64]:
    """A 4×4 matrix of finite numbers; the native part checks that it is a rigid motion."""
    expected = "a rigid motion as an array of shape (4, 4)"
    array = numbers(value, subject, expected)
    if array.shape != (4, 4):
        raise input_error(subject, f"an array of shape {array.shape}", expected, "pass [[R, t], [0, 1]]")
    return array.astype(np.float64)


def _check_names(names: list[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            found = f"the name {name!r} twice"
            raise input_error("scans", found, "a name of its own for every scan", "rename one of them")
        seen.add(name)


def _is_path(value: Any) -> bool:
    return isinstance(value, (str, os.PathLike))


def _is_many(value: Any) -> bool:
    return isinstance(value, Iterable) and not (isinstance(value, np.ndarray) and value.ndim == 2)


def _kind(value: Any) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}"
