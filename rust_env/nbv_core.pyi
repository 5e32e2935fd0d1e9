"""The Rust core of nbv_gym.

Conventions of every function: SI units and radians; world frame with z up; camera frame x right, y down, z forward.
A viewpoint is ``tx ty tz qx qy qz qw``, the pose of the camera in the world (``world_from_camera``); batches have shape
(..., 7). A depth image holds metres: ``+inf`` = nothing within ``far``, ``0`` = nearer than ``near``.

Arrays of real numbers are taken in any float or integer dtype and layout. Errors: ``TypeError`` for a wrong type or an
unknown keyword, ``ValueError`` for a wrong shape or value (the message names the argument and the value), ``OSError``
for files, :class:`InternalError` for a fault of the core itself.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_F32: TypeAlias = NDArray[np.float32]
_F64: TypeAlias = NDArray[np.float64]
_I8: TypeAlias = NDArray[np.int8]
_Bool: TypeAlias = NDArray[np.bool_]

__version__: str
METRICS: list[str]
"""Columns of the buffer ``metrics``, in order: per step ``new_surface_voxels``, ``coverage`` (fraction of the surface
voxels that sight can reach), ``information_gain_bits``, ``uncertainty_gain``; of the map ``entropy`` (bits over the
exploration bounds, an unknown voxel counts one), ``information`` (sum of 1 - u over occupied voxels, Lluvia 2023
Eq. 11), ``known_voxels``, ``occupied_voxels``; of the robot ``travel`` (metres in this step), ``path_length`` (metres
in the episode), ``contact`` (0 or 1), ``views`` (images taken, the first one included), ``time`` (simulated seconds)."""
STAGES: list[str]
"""Stages of a step whose time :meth:`Simulator.timings` reports."""
GAINS: list[str]
"""Names of the view-gain metrics."""
SCENE_KINDS: list[str]
"""Kinds of generated scenes."""
KERNELS: list[str]
"""Which kernels render and walk rays on this processor; the environment variable ``NBV_GYM_INSTRUCTIONS`` (``portable``,
``avx2``) narrows the choice, for tests."""
NOISES: list[str]
"""Names of the presets of depth noise."""

class InternalError(RuntimeError):
    """A fault of nbv-gym's own that was caught at the edge. The environment concerned must be reset."""

@final
class Camera:
    """A pinhole depth camera; immutable, hashable, can be pickled.

    Args:
        width: Image width, 1..=4096 pixels.
        height: Image height, 1..=4096 pixels.
        hfov: Horizontal field of view, the full angle in radians, in (0.001, 3.1).
        vfov: Vertical field of view; by default what makes pixels square.
        near: Nearest depth that is measured, metres, >= 0.
        far: Farthest depth that is measured, metres, > near.
        kind: ``"range"`` = distance along the pixel's ray, ``"z"`` = distance along the optical axis.

    Raises:
        ValueError: A value out of its range.
    """

    def __new__(
        cls,
        width: int,
        height: int,
        hfov: float,
        vfov: float | None = None,
        near: float = 0.0,
        far: float = 4.0,
        kind: str = "range",
    ) -> Camera: ...
    @property
    def width(self) -> int:
        """Pixels."""
    @property
    def height(self) -> int:
        """Pixels."""
    @property
    def hfov(self) -> float:
        """Radians, full angle."""
    @property
    def vfov(self) -> float:
        """Radians, full angle."""
    @property
    def fx(self) -> float:
        """Focal length along x, pixels."""
    @property
    def fy(self) -> float:
        """Focal length along y, pixels."""
    @property
    def cx(self) -> float:
        """Principal point, pixels; the centre of pixel (u, v) is (u + 0.5, v + 0.5)."""
    @property
    def cy(self) -> float:
        """Principal point, pixels."""
    @property
    def near(self) -> float:
        """Metres."""
    @property
    def far(self) -> float:
        """Metres."""
    @property
    def kind(self) -> str:
        """``"range"`` or ``"z"``."""
    def unproject(self, depth: ArrayLike, pose: ArrayLike) -> _F32:
        """World points of a depth image.

        Args:
            depth: (height, width) metres.
            pose: (7,) the viewpoint it was taken from.

        Returns:
            (height, width, 3) metres in the world frame; NaN where nothing was measured.
        """
    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _from_intrinsics(numbers: Sequence[float], kind: str) -> Camera: ...

@final
class Scene:
    """The truth: geometry of a world. For reports, viewers and measurement; agents never see it."""

    @staticmethod
    def load(
        path: str | os.PathLike[str],
        strict: bool = False,
        search_paths: Sequence[str | os.PathLike[str]] = ...,
        honour_up_axis: bool = False,
    ) -> Scene:
        """Read a scene file: .world .sdf .dae .glb .gltf .obj .ply .stl.

        It is kept in memory and on disk (docs/scenes.md), and read again if a file that belongs to it has changed.

        Args:
            path: The file.
            strict: A missing part is an error and not a counted warning.
            search_paths: Folders in which ``model://`` URIs are looked up.
            honour_up_axis: Turn COLLADA parts by their ``up_axis``, which Gazebo ignores.

        Raises:
            OSError: The file, or a part of it in strict mode, cannot be read.
            ValueError: The file is malformed; the message names file and element.
        """
    @staticmethod
    def generate(kind: str, seed: int = 0) -> Scene:
        """A generated scene; the same seed gives the same scene.

        Raises:
            ValueError: ``kind`` is not one of :data:`SCENE_KINDS`.
        """
    @staticmethod
    def cache_info() -> tuple[Path, int, int] | None:
        """Folder of the cache on disk, number of its entries, their bytes; None if it is switched off."""
    @staticmethod
    def clear_cache() -> int:
        """Remove all entries of the cache on disk; returns how many there were.

        Raises:
            OSError: An entry cannot be removed.
        """
    @property
    def name(self) -> str: ...
    @property
    def triangles(self) -> _F32:
        """(m, 3, 3) corners of the visual triangles, metres in the world frame: what cameras see."""
    @property
    def objects(self) -> NDArray[np.uint32]:
        """(m,) the object of each visual triangle, counted from 1; 0: floor, walls, ceiling, ground plane.

        In generated scenes an object is a piece of furniture or a thing on it, in worlds a placed model (its walls, too), in a
        lone mesh file a connected part.
        """
    @property
    def collision_triangles(self) -> _F32:
        """(k, 3, 3) corners of the collision triangles, metres in the world frame."""
    @property
    def bounds(self) -> _F32:
        """(2, 3) lower and upper corner of what is to be explored, metres."""
    @property
    def floor(self) -> float:
        """Height of the floor, metres."""
    @property
    def starts(self) -> _F32:
        """(s, 4) start positions of a camera and its heading: x y z in metres, yaw in radians."""
    @property
    def report(self) -> dict[str, Any]:
        """What the loader found: triangles as read and after cleaning, instances, warnings, missing parts, bounds,
        milliseconds, and what the cache did: "new", "read", "made anew: why", "" for none."""
    @property
    def actors(self) -> list[dict[str, Any]]:
        """People that the file tells of, in the form of a walker of :class:`Setup`'s ``bodies``: path, loop, speed."""
    def render_depth(
        self,
        camera: Camera,
        poses: ArrayLike,
        noise: str | Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> _F32:
        """Depth images.

        Args:
            camera: The camera.
            poses: (..., 7) viewpoints.
            noise: Depth noise as in :class:`Setup`; none by default.
            seed: Of the noise; image i is disturbed alike whatever images come with it.

        Returns:
            (..., height, width) metres.
        """
    def cast_rays(self, origins: ArrayLike, directions: ArrayLike, max_range: float) -> _F32:
        """Distance to the first visual triangle.

        Args:
            origins: (n, 3) metres.
            directions: (n, 3), any length but zero.
            max_range: Metres.

        Returns:
            (n,) metres; ``inf`` = nothing hit, NaN = not a ray.
        """
    def surface_voxels(self, resolution: float) -> _F32:
        """(n, 3) centres of the voxels of ``resolution`` metres that the visual surface touches within the bounds."""
    def visible_voxels(self, camera: Camera, poses: ArrayLike, resolution: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """How much depth images show: the volumetric gain of Wang et al. 2019, section IV-B, is a difference of such counts.

        Args:
            camera: The camera; what is nearer than ``near`` or farther than ``far`` is not seen.
            poses: (..., 7) viewpoints.
            resolution: Side of a voxel, metres.

        Returns:
            Two arrays of shape (...): the distinct voxels, ``floor(coordinate / resolution)``, in which the pixels' rays
            meet the visual surface, and the distinct objects that they meet (see :attr:`objects`; 0 does not count).

        Raises:
            ValueError: ``resolution`` lies outside [1e-4, 1e3], or a viewpoint is none.
        """
    def clearance(self, points: ArrayLike, max_distance: float) -> _F32:
        """Distance to the nearest surface that a body can hit.

        Args:
            points: (n, 3) metres.
            max_distance: Metres; no distance is greater.

        Returns:
            (n,) metres; 0 below the ground plane, NaN for a point that is not finite.

        Raises:
            ValueError: ``max_distance`` is not finite and > 0.
        """

@final
class Octree:
    """A probabilistic voxel map with OctoMap's sensor model and an uncertainty for each occupied voxel.

    The voxel of a point is ``floor(coordinate / resolution)`` per axis. The map of a running environment
    (:attr:`Belief.octree`) has the same queries and is read-only.

    Args:
        resolution: Side of a voxel, metres.
        hit: Probability that a voxel is occupied when a ray ended in it.
        miss: The same when a ray passed through it.
        clamp_min: Lower clamping probability.
        clamp_max: Upper clamping probability.
    """

    def __new__(
        cls,
        resolution: float,
        *,
        view_history: bool = False,
        hit: float = 0.7,
        miss: float = 0.4,
        clamp_min: float = 0.1192,
        clamp_max: float = 0.971,
    ) -> Octree: ...
    def insert_depth(
        self,
        depth: ArrayLike,
        camera: Camera,
        pose: ArrayLike,
        max_range: float | None = None,
        integration: str = "exact",
    ) -> None:
        """Integrate a depth image; every voxel is updated once per image, and a hit beats misses.

        Args:
            depth: (height, width) metres; ``inf`` frees space up to ``max_range``, ``0`` and NaN are left out.
            camera: The camera that took the image.
            pose: (7,) its viewpoint.
            max_range: Metres; measurements beyond free space up to it and hit nothing. By default ``camera.far``.
            integration: ``"exact"`` walks every pixel's ray, as OctoMap does. ``"discretized"`` walks one ray for all
                points in a voxel, to its centre, as OctoMap's ``discretize``. ``"projective"`` walks none: a voxel is free if its
                centre lies in front of what the nearest pixel measured. Both are approximate; see ``docs/map.md``.

        Raises:
            TypeError: This is the map of a running environment.
            ValueError: An argument is out of its range, or the image spans too much space.
        """
    def record_view(self, camera: Camera, pose: ArrayLike, max_range: float | None = None) -> None:
        """Record in the view history that a camera sees, from ``pose`` (7,), every known voxel in its frustum up to
        ``max_range`` metres (``camera.far`` if not given): Wang 2019, Eq. 1 and 2. Call it after the image was inserted.

        Raises:
            ValueError: The map keeps no view history.
        """
    def view_history(self, points: ArrayLike) -> tuple[_F32, _F32]:
        """From where the voxels at points (..., 3) were seen.

        Returns:
            O_k, the occupancy probability at the last sight from each direction (NaN where there was none), and C_k, the
            confidence added up (Wang 2019, Eq. 1 and 2); (..., 36, 18) each: heading of the sensor as seen from the voxel,
            counter-clockwise from +x, and angle from straight up, in steps of pi / 18.

        Raises:
            ValueError: The map keeps no view history.
        """
    def insert_points(self, points: ArrayLike, origin: ArrayLike, max_range: float | None = None, integration: str = "exact") -> None:
        """Integrate a point cloud.

        Args:
            points: (n, 3) metres in the world frame; points that are not finite are left out.
            origin: (3,) the sensor's position.
            max_range: Metres; by default unlimited.
            integration: ``"exact"`` or ``"discretized"``, see :meth:`insert_depth`.

        Raises:
            TypeError: This is the map of a running environment.
        """
    @staticmethod
    def read(path: str | os.PathLike[str], **sensor: float) -> Octree:
        """Read an `.nbvmap` file (all layers), or OctoMap's `.bt` (states) or `.ot` (log-odds).

        Of ColorOcTree and OcTreeStamped geometry and log-odds are read; `.bt` files from before OctoMap 1.4, too.

        Args:
            path: The file; its ending decides.
            **sensor: Of OctoMap's files only: the keywords of the constructor (`hit`, `miss`, `clamp_min`, `clamp_max`)
                for what is inserted later. In a `.bt` map free and occupied become the clamping values.

        Raises:
            OSError: The file cannot be read.
            ValueError: It is damaged, or of a kind or version that is not read; the message names file and cause.
        """
    def write(self, path: str | os.PathLike[str]) -> None:
        """Write an `.nbvmap` file (all layers, bit for bit), or OctoMap's `.bt` (states) or `.ot` (log-odds), by the
        path's ending; complete or not at all.

        Raises ValueError for another ending, OSError if the file cannot be written.
        """
    def clear(self, bounds: ArrayLike | None = None) -> None:
        """Forget everything, or make the voxels unknown again whose centres lie in a box.

        Args:
            bounds: (2, 3) lower and upper corner, metres.

        Raises:
            TypeError: This is the map of a running environment.
        """
    def decay(self, factor: float, forget_below: float = 0.1, bounds: ArrayLike | None = None) -> None:
        """Let knowledge age: every known voxel's log-odds is multiplied by ``factor``; a voxel whose absolute log-odds
        falls below ``forget_below`` becomes unknown. All other states and the uncertainties stay.

        For a half-life of h seconds, call it with ``0.5 ** (dt / h)``.

        Args:
            factor: In [0, 1].
            forget_below: Log-odds > 0; 0.1 is a probability of 0.525.
            bounds: (2, 3) lower and upper corner, metres; only voxels whose centres lie in it.

        Raises:
            TypeError: This is the map of a running environment.
        """
    def changed(self) -> tuple[_F32, _I8, _I8]:
        """The voxels whose state differs from what it was at the last call.

        The first call begins the bookkeeping and gives every known voxel. In a running environment: since the last call
        for it, or since its episode began.

        Returns:
            Centres (n, 3) in metres, states before and after (n,): -1 unknown, 0 free, 1 occupied.
        """
    def nearest(self, points: ArrayLike, state: str = "occupied", max_range: float = ...) -> tuple[_F32, _F32]:
        """The voxels of a state whose centres are nearest to points; exact, of equally near ones the first by z, y, x.

        Args:
            points: (..., 3) metres.
            state: ``"occupied"``, ``"free"`` or ``"unknown"`` (within the map's limits, if it has such).
            max_range: Metres; by default unlimited.

        Returns:
            Centres (..., 3) and distances (...,) in metres; NaN and ``inf`` where there is none, or the point is not
            finite.
        """
    def counts_in(self, bounds: ArrayLike) -> tuple[int, int, int]:
        """How many voxels whose centres lie in a box (2, 3), metres, are unknown, free and occupied."""
    def copy(self) -> Octree:
        """An independent map with the same content; of a running environment's map, too. Maps can be pickled."""
    def __copy__(self) -> Octree: ...
    def __deepcopy__(self, _memo: Any) -> Octree: ...
    def __reduce__(self) -> Any: ...
    @staticmethod
    def _from_bytes(data: bytes) -> Octree: ...
    def cast_rays(self, origins: ArrayLike, directions: ArrayLike, max_range: float, ignore_unknown: bool = False) -> tuple[_F32, _I8]:
        """Rays to the first occupied (or unknown) voxel.

        Args:
            origins: (n, 3) metres.
            directions: (n, 3), any length but zero.
            max_range: Metres.
            ignore_unknown: Pass through unknown voxels instead of stopping.

        Returns:
            Ranges (n,) in metres and states (n,): -1 stopped at an unknown voxel, 0 nothing met, 1 occupied. NaN and -1 of what
            is not a ray: a direction of length zero, numbers that are not finite.
        """
    def view_gain(
        self,
        poses: ArrayLike,
        camera: Camera,
        metric: str = "unknown_count",
        stride: int | None = None,
        max_range: float | None = None,
        num_threads: int = 1,
        angle_step: float | None = None,
    ) -> _F64:
        """What a view is expected to tell.

        Args:
            poses: (k, 7) viewpoints.
            camera: The camera that would look.
            metric: One of :data:`GAINS`.
            stride: Cast a ray for every ``stride``-th pixel along both axes; 1 if not given.
            max_range: Length of the rays, metres; by default ``camera.far``.
            num_threads: Threads over views; the result does not depend on it.
            angle_step: Instead of ``stride``: a ray every so many radians over the field of view, in both directions.

        Returns:
            (k,) gains. ``"view_history"`` needs a map that keeps one.
        """
    def log_odds(self, points: ArrayLike) -> _F32:
        """Log-odds of occupancy at points (..., 3); NaN where unknown."""
    def probability(self, points: ArrayLike) -> _F32:
        """Probability of occupancy at points (..., 3); 0.5 where unknown."""
    def classify(self, points: ArrayLike) -> _I8:
        """State at points (..., 3): -1 unknown, 0 free, 1 occupied."""
    def uncertainty(self, points: ArrayLike) -> _F32:
        """Uncertainty u in [0, 1] at points (..., 3); 1 where unknown."""
    def occupied(self, bounds: ArrayLike | None = None) -> _F32:
        """(n, 3) centres of the occupied voxels, metres; of those in the box ``bounds`` (2, 3), if given."""
    def free(self, bounds: ArrayLike | None = None) -> _F32:
        """(n, 3) centres of the free voxels, metres; of those in the box ``bounds`` (2, 3), if given."""
    def unknown(self, bounds: ArrayLike | None = None) -> _F32:
        """(n, 3) centres of the unknown voxels in the box ``bounds`` (2, 3), metres; by default the map's limits.

        Raises ValueError without both, and for more than 2^26 voxels.
        """
    def occupied_uncertainty(self) -> _F32:
        """(n,) uncertainty of the occupied voxels, in the order of :meth:`occupied`."""
    def frontiers(self) -> _F32:
        """(n, 3) centres of the free voxels beside unknown space, metres."""
    def slice(self, z_min: float, z_max: float, bounds: ArrayLike | None = None) -> tuple[_I8, tuple[float, float]]:
        """A map seen from above: occupied where anything between two heights is.

        Args:
            z_min: Metres.
            z_max: Metres.
            bounds: (2, 3) lower and upper corner; by default the map's own.

        Returns:
            The grid (rows along y, columns along x; -1 unknown, 0 free, 1 occupied) and the x, y of its lower-left
            corner in metres.
        """
    def information(self) -> float:
        """Sum of 1 - u over the occupied voxels (Lluvia 2023, Eq. 11)."""
    def entropy(self) -> float:
        """Bits of entropy over the known voxels."""
    def memory_bytes(self) -> int:
        """Bytes that the map holds."""
    def recount(self) -> tuple[int, int, float, float]:
        """Known voxels, occupied voxels, bits of entropy and information, counted again voxel by voxel."""
    @property
    def num_known(self) -> int: ...
    @property
    def num_occupied(self) -> int: ...
    @property
    def resolution(self) -> float:
        """Side of a voxel, metres."""
    @property
    def bounds(self) -> _F32:
        """(2, 3) lower and upper corner of the known space, metres."""

@final
class Setup:
    """What is simulated; immutable.

    Args:
        scene: A scene file, or a generated kind: ``"room"``, ``"room:7"`` (one seed), ``"room:0-63"`` (each episode
            draws one of these).
        camera: The depth camera.
        robot: ``{"kind": "flying", "radius": 0.1, "speed": 0.5, "turn_rate": 1.5}``: a camera in a ball of ``radius`` metres that
            moves at ``speed`` m/s and turns at ``turn_rate`` rad/s. ``{"kind": "arm", ..., "upper_arm": 0.425, "forearm":
            0.392, "link_radius": 0.06}``, metres: the same ball in the hand of an arm of two links (those of a UR5), whose
            shoulder stands in the middle of the dome of views. The elbow lies above the line from shoulder to hand, in
            the vertical plane through both. The hand moves in spherical coordinates around the shoulder, azimuth the
            shorter way; links and ball stop at what they meet. Cameras do not see the arm.
        map: ``{"resolution": metres, "max_range": metres, "integration": name, "hit", "miss", "clamp_min", "clamp_max"}``;
            only the resolution is required, ``max_range`` is by default the camera's ``far``, ``integration`` ``"exact"`` (see
            :meth:`Octree.insert_depth`).
        views: Candidate views. ``{"kind": "six_directions", "step": metres}`` moves the current viewpoint up, down,
            forward, backward, right, left; ``{"kind": "dome", "rings", "per_ring", "radius", "min_pitch",
            "max_pitch", "reach"}`` looks outwards from a dome around the start; ``{"kind": "ring", "positions", "radius",
            "pitches", "reach"}`` looks inwards from rings around the middle of the scene. ``reach``: up to how many headings
            and pitches away a view's neighbours are (:meth:`Belief.neighbours`), 1 unless given.
        local_map: ``{"size": cells along a side, "cell": metres}``, the egocentric window of the buffer ``local_map``.
        noise: Noise of the depth images: a name of :data:`NOISES`, or ``{"kind": name}`` with values that differ from the
            preset's: ``constant``, ``growth``, ``nearest`` (sigma = constant + growth * (z - nearest)^2 metres, Nguyen,
            Izadi & Lovell 2012), ``disparity_step`` (pixels; 0 = none), ``focal_baseline`` (pixels times metres),
            ``max_incidence`` and ``edge_incidence`` (radians; pi/2 = nothing is lost). Lost pixels are 0.
        lidar: ``{"range": metres, "rays": 720, "near": 0.0, "mount": metres above the camera, "sigma": metres}``, a planar
            lidar for the buffer ``scan``; only the range is required. Ray i has the bearing 2 pi i / rays,
            counter-clockwise from the camera's heading.
        bodies: What moves: ``{"walkers": ..., "boxes": ..., "actors": bool}``. Walkers and boxes are a number to draw where
            there is room, from the episode's own random stream, or a list: ``{"path": (k, 2) way-points on the floor,
            "loop": False, "speed": 0.8 m/s, "radius": 0.28, "height": 1.8}`` and ``{"position": (x, y) on the floor or the
            centre (x, y, z), "size": (3,) metres, "yaw": radians, "density": kg/m^3}``. ``actors``: whether the people of
            the scene's file walk.
        truth: The surface voxels that ``coverage`` is measured against. ``"sight"``: those that some view of the task can
            see, from anywhere within its image. ``"images"``: those that the map holds after a perfect image from each
            view that the robot can take, in their order; for domes and rings. This is the reference of Wang et al. 2019
            (section VI-B: the full dome path counts as 100 %). An episode that visits all views ends at 98 to 100 %, by their
            order (docs/map.md).

    Raises:
        TypeError: An unknown keyword, or a value of the wrong type.
        ValueError: A value out of its range.
        FileNotFoundError: ``scene`` is neither a file nor a kind.
    """

    def __new__(
        cls,
        scene: str | os.PathLike[str],
        camera: Camera,
        robot: Mapping[str, Any],
        map: Mapping[str, Any],
        views: Mapping[str, Any],
        local_map: Mapping[str, Any] | None = None,
        noise: str | Mapping[str, Any] | None = None,
        lidar: Mapping[str, Any] | None = None,
        bodies: Mapping[str, Any] | None = None,
        truth: str = "sight",
    ) -> Setup: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def resolution(self) -> float:
        """Side of a voxel of the map, metres."""
    @property
    def local_map_size(self) -> int:
        """Cells along a side of the local map; 0 without one."""
    @property
    def lidar_rays(self) -> int:
        """Rays of a scan; 0 without a lidar."""
    @property
    def num_candidates(self) -> int:
        """Candidate views per step, K."""

@final
class Simulator:
    """n episodes stepped by Rust into NumPy buffers, in place and with the GIL released.

    Results depend neither on ``num_threads`` nor on ``num_envs``. Buffers are C-contiguous arrays in a dictionary; a
    missing key is not computed: ``depth`` (n, height, width) f32 metres, ``scan`` (n, rays) f32 metres (``inf`` = nothing
    within range, 0 = nearer than near), ``pose`` (n, 7) f32, ``local_map``
    (n, 3, size, size, size) f32 (probability of occupancy with 0.5 = unknown, uncertainty, unknown), ``visited``
    (n, K) f32 counts, ``candidates`` (n, K, 7) f32, ``mask`` (n, K) bool, ``metrics`` (n, len(METRICS)) f64.

    Args:
        setup: What is simulated.
        num_envs: Episodes at once, n.
        num_threads: Threads of the simulator's own pool; none is started for 1.
    """

    def __new__(cls, setup: Setup, num_envs: int = 1, num_threads: int = 1) -> Simulator: ...
    def reset(self, mask: _Bool, seeds: Sequence[int | None], buffers: dict[str, NDArray[Any]]) -> None:
        """Begin new episodes.

        Args:
            mask: (n,) which environments; rows of the others stay as they are.
            seeds: n seeds; ``None`` goes on with that environment's stream of seeds.
            buffers: See the class.
        """
    def step(self, commands: _F32, reset_mask: _Bool, buffers: dict[str, NDArray[Any]]) -> None:
        """Go to viewpoints, look, and update the maps. All viewpoints are checked before anything changes.

        Args:
            commands: (n, 7) viewpoints.
            reset_mask: (n,) environments that begin a new episode instead.
            buffers: See the class.
        """
    def save(self, notes: bytes | None = None) -> bytes:
        """All environments as they are now: worlds, maps, random streams. ``notes`` are the caller's own.

        Raises:
            InternalError: An environment failed and was not reset since.
        """
    def load(self, snapshot: bytes, buffers: dict[str, NDArray[Any]]) -> None:
        """Go on, bit for bit, where a simulator of the same setup and number of environments was saved.

        Scenes are opened again. The rows of environments without an episode stay as they are. Nothing in the bytes is
        executed, and nothing changes on an error.

        Raises:
            ValueError: Damaged bytes, another version or setup, or a scene whose content changed.
            OSError: A scene's file cannot be read.
        """
    @staticmethod
    def read_notes(snapshot: bytes) -> bytes:
        """The notes of a snapshot; raises ValueError for bytes that are none."""
    def belief(self, i: int) -> Belief:
        """The planner's view of environment ``i``, live.

        Raises:
            ValueError: No such environment, or it has no episode yet.
        """
    @property
    def num_envs(self) -> int: ...
    @property
    def num_candidates(self) -> int:
        """Candidate views per step, K."""
    def scene(self, i: int) -> Scene:
        """The truth of environment ``i``; for viewers and reports only."""
    def body_poses(self, i: int) -> _F32:
        """(k, 7) poses of what moves in environment ``i``: the feet of walkers, then the centres of boxes. The truth."""
    def body_triangles(self, i: int) -> _F32:
        """(m, 3, 3) corners of their triangles as sensors see them, metres in the world frame. The truth."""
    def true_gain(self, i: int, poses: ArrayLike) -> _F64:
        """The metrics that a step to each viewpoint would give; nothing changes. For oracles only.

        Args:
            i: Environment.
            poses: (k, 7) viewpoints.

        Returns:
            (k, len(METRICS)).
        """
    def true_contact(self, i: int, poses: ArrayLike) -> NDArray[np.bool_]:
        """Whether contact would stop the robot on its way to each viewpoint; nothing changes. For oracles only.

        Args:
            i: Environment.
            poses: (k, 7) viewpoints.

        Returns:
            (k,).
        """
    def truth_surface(self, i: int) -> _F32:
        """(n, 3) centres of the surface voxels that coverage is measured against, see ``truth`` of :class:`Setup`."""
    def timings(self) -> dict[str, float]:
        """Wall-clock seconds per stage, all environments together; keys :data:`STAGES`."""

@final
class Belief:
    """What a planner may see of one environment; a live, read-only view."""

    @property
    def octree(self) -> Octree:
        """The map, read-only."""
    @property
    def pose(self) -> _F32:
        """(7,) where the robot believes its camera to be."""
    @property
    def bounds(self) -> _F32:
        """(2, 3) lower and upper corner of what is to be explored, metres."""
    @property
    def camera(self) -> Camera: ...
    @property
    def resolution(self) -> float:
        """Side of a voxel, metres."""
    @property
    def candidates(self) -> _F32:
        """(K, 7) the views that the task offers now."""
    @property
    def candidate_mask(self) -> _Bool:
        """(K,) admissible by belief: within the bounds, not in occupied space, and not where touch taught better.

        A goal that the robot was sent to and did not reach (something stopped it that no image showed) is not admissible
        again, nor is anything behind what stopped it (within 60 degrees of the way, seen from where it stopped) and nearer to
        the goal than the robot ever came, for the rest of the episode; unless that leaves no candidate at all.
        """
    @property
    def visited(self) -> NDArray[np.uint16]:
        """(K,) how often each candidate was visited."""
    @property
    def trajectory(self) -> _F32:
        """(t, 7) the viewpoints so far, the start first."""
    def neighbours(self) -> NDArray[np.int64]:
        """Indices of the candidates next to the one that the camera is nearest to (up to eight on a dome or a ring, more where its
        ``reach`` is longer); none where candidates move with the camera."""
    @property
    def depth(self) -> _F32:
        """(height, width) the last depth image, metres; ``inf`` where nothing was met."""
    def view_gain(
        self, poses: ArrayLike, metric: str = "unknown_count", stride: int | None = None, angle_step: float | None = None
    ) -> _F64:
        """(k,) expected gains of viewpoints (k, 7) by this map and camera; see :meth:`Octree.view_gain`."""
    def travel_cost(self, poses: ArrayLike) -> _F32:
        """(k,) metres to viewpoints (k, 7) along a path through space that is not occupied; ``inf`` = none.

        For an arm the way of its hand from view to neighbouring view of the dome, links and ball clear of what is known to
        be occupied.
        """
    def reachable(self, poses: ArrayLike) -> _Bool:
        """(k,) whether known free space leads to viewpoints (k, 7).

        For an arm, whose links are never in the image: whether :meth:`travel_cost` is finite.
        """
    def path_to(self, pose: ArrayLike) -> _F32:
        """(m, 3) way-points to a viewpoint (7,), metres; an arm swings from each to the next around its shoulder."""
    def frontiers(self) -> _F32:
        """(n, 3) centres of the free voxels beside unknown space within the bounds, metres."""
    def slice(self, z_min: float, z_max: float) -> tuple[_I8, tuple[float, float]]:
        """The map seen from above within the bounds; see :meth:`Octree.slice`."""
    def sample_free(self, count: int, seed: int) -> _F32:
        """(k <= count, 7) viewpoints, uniform in known free space, with random headings."""
