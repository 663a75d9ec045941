"""The native part (python/src). Arguments are checked by the modules beside it."""

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ._progress import Reporter

__version__: str
__all__ = [
    "Config",
    "Run",
    "Scan",
    "__version__",
    "check_shards",
    "command",
    "describe",
    "describe_shard",
    "evaluate_poses",
    "predict_overlap",
    "read",
    "register",
    "register_pair",
    "register_shard",
    "synthesize",
]

@final
class Scan:
    """One scan: a name and its points, metres, in the frame of its file or array."""

    def __new__(
        cls,
        name: str,
        points: NDArray[Any],
        colors: NDArray[np.uint8] | None = None,
        normals: NDArray[np.float32] | None = None,
        viewpoint: tuple[float, float, float] | None = None,
        initial_pose: NDArray[np.float64] | None = None,
    ) -> Scan: ...
    @property
    def name(self) -> str: ...
    @property
    def file(self) -> str | None: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def colors(self) -> NDArray[np.uint8] | None: ...
    @property
    def normals(self) -> NDArray[np.float32] | None: ...
    @property
    def viewpoint(self) -> NDArray[np.float64] | None: ...
    @property
    def initial_pose(self) -> NDArray[np.float64] | None: ...
    @property
    def left_out(self) -> tuple[int, int]: ...
    def renamed(self, name: str) -> Scan: ...
    def __len__(self) -> int: ...

@final
class Config:
    """Effective settings, checked."""

    def __new__(
        cls, preset: str, file: str | None, settings: dict[str, Any] | None, seed: int | None
    ) -> Config: ...
    @staticmethod
    def from_toml(text: str, seed: int) -> Config: ...
    @property
    def seed(self) -> int: ...
    def to_toml(self) -> str: ...
    def __eq__(self, other: object, /) -> bool: ...

@final
class Run:
    """A finished registration."""

    def poses_json(self) -> str: ...
    def config_toml(self) -> str: ...
    @property
    def lengths_m(self) -> tuple[float, float]: ...
    @property
    def timings(self) -> list[tuple[str, float]]: ...
    @property
    def remarks(self) -> list[tuple[bool, str]]: ...
    @property
    def predicted_overlap(self) -> NDArray[np.float32]: ...
    def merged(
        self, component: int, voxel_m: float | None
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None, NDArray[np.uint32]]: ...
    def placed_points(self, scan: int) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None] | None: ...
    def pose_graph(
        self, component: int
    ) -> tuple[list[int], list[tuple[int, int, tuple[NDArray[np.float64], NDArray[np.float64], bool]]]]: ...
    def save(self, folder: str, force: bool, trajectory: list[str], pose_graph: list[str]) -> None: ...
    def html(self) -> str: ...
    def evaluate(
        self,
        truth: list[NDArray[np.float64]] | None,
        folder: str | None,
        limits: tuple[float | None, float],
        benchmark: tuple[str, float] | None,
    ) -> str: ...

_Given = tuple[Scan, bool]

def command(arguments: list[str]) -> int: ...
def read(
    inputs: list[str], recursive: bool, skip_unreadable: bool, config: Config, progress: Reporter | None
) -> tuple[list[Scan], list[tuple[bool, str]]]: ...
def register(
    scans: list[_Given],
    config: Config,
    initial_poses: bool,
    cache: str | None,
    stages: tuple[str, str] | None,
    threads: int | None,
    progress: Reporter | None,
) -> Run: ...
def register_pair(
    target: _Given, source: _Given, config: Config, threads: int | None, progress: Reporter | None
) -> tuple[NDArray[np.float64] | None, bool, str, str | None]: ...
def describe(
    scans: list[_Given], config: Config, threads: int | None, progress: Reporter | None
) -> list[tuple[NDArray[np.float64], NDArray[np.float32]]]: ...
def check_shards(config: Config) -> None: ...
def describe_shard(
    scans: list[_Given],
    config: Config,
    output: str,
    shard: tuple[int, int],
    force: bool,
    threads: int | None,
    progress: Reporter | None,
) -> None: ...
def register_shard(
    scans: list[_Given],
    config: Config,
    described: str,
    output: str,
    shard: tuple[int, int],
    force: bool,
    threads: int | None,
    progress: Reporter | None,
) -> None: ...
def predict_overlap(
    scans: list[_Given], config: Config, threads: int | None, progress: Reporter | None
) -> NDArray[np.float32]: ...
def synthesize(
    scans: int, rooms: int, unrelated: int, noise: float, seed: int
) -> tuple[list[Scan], list[NDArray[np.float64]], list[bool]]: ...
def evaluate_poses(
    poses: list[NDArray[np.float64] | None], truth: list[NDArray[np.float64]], limits: tuple[float, float]
) -> str: ...
