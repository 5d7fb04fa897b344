"""The camera: pinhole projection, lens distortion, and their derivatives.

Image coordinates are OpenCV's: x right, y down, pixel centres at integers. This module depends on the lens only. An
image without distortion, and the camera with fewer coefficients that projects most alike, follow from it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.arrays import Array, Array32
from calib.errors import InputMismatch
from calib.model.lens import BROWN, FISHEYE, OPENCV, OPENCV_LENGTHS, distort_with_jacobians, is_fisheye

PINHOLE = ("fx", "fy", "cx", "cy")
#: Name of the skew: the element K[0, 1] of the camera matrix, px. MATLAB can estimate it; OpenCV's model has none. It
#: is estimated beside coefficients of Brown's model.
SKEW = "skew"
#: A fold of the distortion is looked for at so many places along a line.
_ALONG = 1000
#: Tangent of an angle beyond which no lens sees: a step that goes there does not come back.
_FARTHEST = 1e6
#: Sets of distortion coefficients, by the names that the command line accepts.
DISTORTION_SETS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "k1": ("k1",),
    "k1k2": ("k1", "k2"),
    "k1k2k3": ("k1", "k2", "k3"),
    "k1k2p1p2": ("k1", "k2", "p1", "p2"),
    "k1k2k3p1p2": ("k1", "k2", "p1", "p2", "k3"),
    "rational": BROWN,
    "fisheye": FISHEYE,
}


#: Coefficients that can be estimated together.
_FAMILIES = ((*BROWN, SKEW), FISHEYE)
_ONE_NAME = re.compile(r"k[1-6]|p[12]|kb[1-4]|skew")
_STEPS = 20  # At most, of Gauss and Newton, which end when nothing changes
_POINTS_ACROSS = 33  # And down: of the grid of image points that it is fitted to

#: Pixels that are worked on at once.
_BLOCK = 200_000
#: A point of the rectified image farther out than every ray of the sensor would fold back into the image.
_BEYOND = 1.0 + 1e-6
_OUTSIDE = -1.0  # A place that `cv2.remap` fills with its border


def distortion_names(chosen: str | Sequence[str]) -> tuple[str, ...]:
    """Return the coefficients of a named set, or check a sequence of coefficients; in the order of their lens family.

    Beside a set of `DISTORTION_SETS`: names of one family, and `SKEW` beside those of Brown's model; also in one word.

    Examples
    --------
    >>> distortion_names("k1k2")
    ('k1', 'k2')
    >>> distortion_names("k1k2skew")
    ('k1', 'k2', 'skew')
    """
    if isinstance(chosen, str):
        if chosen in DISTORTION_SETS:
            return DISTORTION_SETS[chosen]
        names = _ONE_NAME.findall(chosen)
        if not names or "".join(names) != chosen or len(set(names)) != len(names):
            known = ", ".join(DISTORTION_SETS)
            raise InputMismatch(
                f"Unknown distortion {chosen!r}.",
                remedy=f"Known: {known}; or coefficients in one word, such as k1k2skew.",
            )
        chosen = names
    for family in _FAMILIES:
        if set(chosen) <= set(family):
            return tuple(name for name in family if name in chosen)
    known = " or ".join(" ".join(family) for family in _FAMILIES)
    raise InputMismatch(f"No lens model has the coefficients {' '.join(chosen)}.", remedy=f"Known: {known}.")


@dataclass(frozen=True)
class CameraModel:
    """A camera: pinhole projection and lens distortion (`calib.model.lens`).

    Parameters
    ----------
    fx, fy
        Focal lengths, px.
    cx, cy
        Principal point, px.
    image_size
        Width and height, px.
    distortion
        Distortion coefficients by name, dimensionless, and the skew (`SKEW`), px. Those that are not named are zero.
        The named ones are estimated in a calibration.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    image_size: tuple[int, int]
    distortion: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of_matrix(
        cls, matrix: Array, image_size: tuple[int, int], distortion: Sequence[str] = ()
    ) -> CameraModel:
        """Return the camera with a camera matrix.

        Parameters
        ----------
        matrix
            (3, 3) camera matrix K without skew, px.
        image_size
            Width and height, px.
        distortion
            Names of the coefficients that `distortion` holds.

        Returns
        -------
        CameraModel
            The camera; all its coefficients are zero.
        """
        fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return cls(fx, fy, cx, cy, image_size, dict.fromkeys(distortion, 0.0))

    @property
    def matrix(self) -> Array:
        """(3, 3) float64 camera matrix K, px."""
        return np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def skew(self) -> float:
        """Element K[0, 1] of the camera matrix, px; 0 unless `distortion` names it."""
        return self.distortion.get(SKEW, 0.0)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `values`."""
        return (*PINHOLE, *self.distortion)

    @property
    def values(self) -> Array:
        """(4 + K,) float64 values of the parameters: fx, fy, cx, cy in px, then `distortion`."""
        return np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion.values()])

    @property
    def coefficients(self) -> Array:
        """(8,) float64 coefficients of Brown's model in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6.

        If the lens has them: (12,) with those of a thin prism s1 s2 s3 s4, (14,) with the sensor's tilt tauX tauY.

        Raises
        ------
        InputMismatch
            If the lens is a fisheye lens, which has none of them.
        """
        if is_fisheye(self.distortion):
            raise InputMismatch("A fisheye lens has no coefficients k1 to k6, p1, p2.")
        last = max((OPENCV.index(name) for name in self.distortion if name in OPENCV), default=0)
        length = next(length for length in OPENCV_LENGTHS if length > max(last, len(BROWN) - 1))
        return np.array([self.distortion.get(name, 0.0) for name in OPENCV[:length]])

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens follows the fisheye model (Kannala and Brandt)."""
        return is_fisheye(self.distortion)

    @property
    def fisheye_coefficients(self) -> Array:
        """(4,) float64 coefficients of the fisheye model, in the order of OpenCV's fisheye functions.

        Raises
        ------
        InputMismatch
            If the lens follows Brown's model, which has none of them.
        """
        if not is_fisheye(self.distortion):
            raise InputMismatch("A lens of Brown's model has no coefficients kb1 to kb4.")
        return np.array([self.distortion.get(name, 0.0) for name in FISHEYE])

    def with_values(self, values: Array) -> CameraModel:
        """Return the same model with other parameter values.

        Parameters
        ----------
        values
            (4 + K,) values in the order of `parameter_names`; px for the first four.

        Returns
        -------
        CameraModel
            Camera with these values, the same image size and the same coefficient names.
        """
        fx, fy, cx, cy, *coefficients = (float(v) for v in values)
        distortion = dict(zip(self.distortion, coefficients, strict=True))
        return CameraModel(fx, fy, cx, cy, self.image_size, distortion)

    def project(self, points: Array) -> Array:
        """Project points to the image.

        Pinhole projection: Hartley and Zisserman (2004), section 6.1. Distortion: `calib.model.lens`.

        Parameters
        ----------
        points
            (N, 3) points in the camera frame, any length unit.

        Returns
        -------
        Array
            (N, 2) image points, px. NaN for points that are not in front of the camera (Z <= 0).

        Raises
        ------
        InputMismatch
            If the points have another shape.
        """
        points = np.asarray(points, float)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputMismatch(
                f"The points have the shape {points.shape}, not (N, 3).",
                remedy="Give X, Y and Z of each point.",
            )
        return self.project_with_jacobians(np.where(points[:, 2:] > 0, points, np.nan))[0]

    def project_with_jacobians(self, points: Array) -> tuple[Array, Array, Array]:
        """Project points to the image and return the derivatives.

        Projection: Hartley and Zisserman (2004), section 6.1, as in `project`. The derivatives are this project's own,
        by the chain rule; the derivative along a ray is zero.

        Parameters
        ----------
        points
            (N, 3) points in the camera frame with Z > 0, any length unit.

        Returns
        -------
        tuple of Array
            (N, 2) image points, px; (N, 2, 3) derivatives by the points, px per length unit; (N, 2, 4 + K) derivatives
            by the parameters in the order of `parameter_names`.
        """
        x, y, z = np.ascontiguousarray(points.T)
        inverse_z = 1.0 / z
        normalised = np.array([x * inverse_z, y * inverse_z])
        distorted, by_normalised, by_coefficients = distort_with_jacobians(normalised.T, self.distortion)
        focal = np.array([self.fx, self.fy])
        pixels = distorted * focal + [self.cx, self.cy]
        skew = self.skew
        if skew:
            pixels[:, 0] += skew * distorted[:, 1]

        # One contiguous row over the points for each derivative: several times faster than one small matrix a point.
        by_points = np.empty((2, 3, len(x)))
        by_points[:, :2] = by_normalised.transpose(1, 2, 0) * (focal[:, None, None] * inverse_z)
        if skew:
            by_points[0, :2] += by_normalised.transpose(1, 2, 0)[1] * (skew * inverse_z)
        by_points[:, 2] = -(by_points[:, 0] * normalised[0] + by_points[:, 1] * normalised[1])

        by_parameters = np.zeros((4 + len(self.distortion), 2, len(x)))
        by_parameters[0, 0], by_parameters[1, 1] = distorted.T
        by_parameters[2, 0] = by_parameters[3, 1] = 1.0
        lens = by_coefficients.transpose(2, 1, 0)
        by_parameters[4:] = lens * focal[:, None]
        if SKEW in self.distortion:
            by_parameters[4:, 0] += lens[:, 1] * skew
            by_parameters[4 + list(self.distortion).index(SKEW), 0] = distorted[:, 1]
        return pixels, by_points.transpose(2, 0, 1), by_parameters.transpose(2, 1, 0)

    def rays(self, points_px: Array) -> Array:
        """Return the unit rays that are seen at image points: the inverse of `project`.

        The distortion is inverted by Newton's method. Own derivation: the step is J^-1 (wanted - distorted), with the
        inverse of the 2 x 2 Jacobian written out.

        Parameters
        ----------
        points_px
            (N, 2) image points, px.

        Returns
        -------
        Array
            (N, 3) unit vectors in the camera frame. NaN where the distortion cannot be inverted (beyond the radius at
            which it folds back).
        """
        wanted = (np.asarray(points_px, float) - [self.cx, self.cy]) / [self.fx, self.fy]
        wanted[:, 0] -= self.skew / self.fx * wanted[:, 1]
        normalised = wanted.copy()
        for _ in range(30):
            distorted, slope, _ = distort_with_jacobians(normalised, self.distortion)
            determinant = _determinants(slope)
            # The distortion has folded back if the determinant is not positive.
            error = (wanted - distorted) / np.where(determinant > 0, determinant, np.nan)[:, None]
            along_x = slope[:, 1, 1] * error[:, 0] - slope[:, 0, 1] * error[:, 1]
            along_y = slope[:, 0, 0] * error[:, 1] - slope[:, 1, 0] * error[:, 0]
            step = np.column_stack([along_x, along_y])
            normalised = normalised + step
            normalised[np.abs(normalised) > _FARTHEST] = np.nan
            if not (np.abs(step) > 1e-14).any():
                break
        inverted = np.abs(distort_with_jacobians(normalised, self.distortion)[0] - wanted).max(axis=1) < 1e-9
        inverted &= np.hypot(*normalised.T) < self._fold(np.hypot(*normalised[inverted].T).max(initial=0.0))
        rays = np.column_stack([normalised, np.ones(len(normalised))])
        rays[~inverted] = np.nan
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _fold(self, reach: float) -> float:
        """Return the tangent of the angle at which the distortion folds back; infinite if it does not within ``reach``.

        Beyond it a step can end where the distortion rises again.
        """
        along = np.linspace(0.0, reach, _ALONG)
        slope = distort_with_jacobians(np.column_stack([along, np.zeros(_ALONG)]), self.distortion)[1]
        return float(along[_determinants(slope) <= 0.0].min(initial=np.inf))

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name.

        Returns
        -------
        dict of str to float
            Focal lengths and principal point, px, and the distortion coefficients.
        """
        return dict(zip(self.parameter_names, self.values.tolist(), strict=True))


def _determinants(slopes: Array) -> Array:
    """Return the (N,) determinants of (N, 2, 2) matrices."""
    return np.asarray(slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0])


def require_image_size(camera: CameraModel, size: tuple[int, int], who: str) -> None:
    """Refuse what has another image size, px, than a known camera; ``who`` has it, such as "this view has"."""
    if camera.image_size != size:
        sizes = [" x ".join(str(side) for side in both) for both in (camera.image_size, size)]
        raise InputMismatch(
            f"The camera has {sizes[0]} px, {who} {sizes[1]} px.",
            remedy="Give a calibration of the same sensor and the same region of interest.",
        )


def nearest_lens(camera: CameraModel, names: Sequence[str]) -> tuple[CameraModel, float]:
    """Fit a camera with only the given coefficients; return it, and its largest difference over the sensor, px.

    Gauss-Newton over a grid of equal weights; focal lengths and principal point are free, the axes stay.
    """
    width, height = camera.image_size
    across = np.linspace(0, width - 1, _POINTS_ACROSS), np.linspace(0, height - 1, _POINTS_ACROSS)
    pixels = np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)
    rays = camera.rays(pixels)
    seen = np.isfinite(rays).all(axis=1)
    pixels, rays = pixels[seen], rays[seen]
    lens = {name: camera.distortion.get(name, 0.0) for name in names}
    nearest = replace(camera, distortion=lens)
    for _ in range(_STEPS):
        there, _, by_values = nearest.project_with_jacobians(rays)
        slope = by_values.reshape(-1, by_values.shape[2])
        scale = np.linalg.norm(slope, axis=0)
        step = np.linalg.lstsq(slope / scale, (pixels - there).ravel(), rcond=None)[0] / scale
        nearest = nearest.with_values(nearest.values + step)
        if np.abs(step * scale).max() < 1e-9:
            break
    return nearest, float(np.linalg.norm(nearest.project(rays) - pixels, axis=1).max())


@dataclass(frozen=True)
class Undistortion:
    """Tables of a camera for its image without distortion."""

    rays: Array32  # (H, W, 3) float32 unit vector of each pixel in the camera's frame; NaN without a ray
    rectified_px: Array32  # (H, W, 2) float32 place of each pixel in the rectified image; NaN without a ray
    # (H, W, 2) float32 where the rectified image takes each pixel from, as ``cv2.remap`` has it; -1 from nowhere.
    map_px: Array32
    camera: CameraModel  # The camera of the rectified image: a pinhole

    @property
    def without_ray(self) -> float:
        """Share of the pixels that have no ray: there the distortion folds back."""
        return float(np.isnan(self.rays[..., 0]).mean())


def undistort(
    camera: CameraModel,
    keep: float = 0.0,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Undistortion:
    """Return the tables of a camera, whose border's rays must fill a plane image.

    ``keep`` 0 leaves no empty pixel in the rectified image, 1 keeps every pixel of the sensor; between them the camera
    matrix is interpolated, as by ``cv2.getOptimalNewCameraMatrix``. ``progress`` is told how many blocks of pixels of
    all have been calculated.
    """
    width, height = camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float)
    rays = _in_blocks(pixels, camera.rays, lambda done, all_: progress(done, 2 * all_))
    plane = rays[:, :2] / rays[:, 2:]
    pinhole = _rectified(plane.reshape(height, width, 2), keep, camera.image_size)
    scale, middle = np.array([pinhole.fx, pinhole.fy]), np.array([pinhole.cx, pinhole.cy])
    reach = _BEYOND * np.nanmax(np.linalg.norm(plane, axis=1))
    wanted = (pixels - middle) / scale
    points = np.insert(wanted, 2, 1.0, axis=1)
    image_px = _in_blocks(points, camera.project, lambda done, all_: progress(all_ + done, 2 * all_))
    seen = (np.linalg.norm(wanted, axis=1) <= reach) & np.isfinite(image_px).all(axis=1)
    pairs = rays, plane * scale + middle, np.where(seen[:, None], image_px, _OUTSIDE)
    of_rays, rectified, maps = (each.astype(np.float32).reshape(height, width, -1) for each in pairs)
    return Undistortion(of_rays, rectified, maps, pinhole)


def _in_blocks(points: Array, work: Callable[[Array], Array], progress: Callable[[int, int], None]) -> Array:
    """Do a work on (N, M) points block by block; ``progress`` is told how many blocks of all are done."""
    starts = range(0, len(points), _BLOCK)
    parts = []
    for number, start in enumerate(starts, start=1):
        parts.append(work(points[start : start + _BLOCK]))
        progress(number, len(starts))
    return np.concatenate(parts)


def _rectified(plane: Array, keep: float, image_size: tuple[int, int]) -> CameraModel:
    """Return the pinhole whose image is a rectangle between the largest inside the rays and the smallest around them.

    ``plane`` is (H, W, 2), the rays at the distance 1, NaN without a ray. Own: the sides of a rectangle fall on the
    first and the last pixel centres, and the parameters of the two are mixed.
    """
    sides = (plane[:, 0, 0], plane[:, -1, 0], plane[0, :, 1], plane[-1, :, 1])
    if any(np.isnan(side).all() for side in sides):
        raise InputMismatch(
            "The pixels along a side of the image have no ray in front of the camera.",
            remedy="A flat image cannot show all that this lens sees."
            " If the lens is not that wide, its calibration is wrong there.",
        )
    left, right, top, bottom = sides
    inner = np.array([np.nanmax(left), np.nanmin(right), np.nanmax(top), np.nanmin(bottom)])
    outer = np.array([np.nanmin(left), np.nanmax(right), np.nanmin(top), np.nanmax(bottom)])
    if not (inner[1] > inner[0] and inner[3] > inner[2]):
        raise InputMismatch(
            "The rays of the border leave no plane image between them.",
            remedy="Check the calibration: its distortion is too large.",
        )
    width, height = image_size
    bounds = np.zeros(4)
    for share, (first_x, last_x, first_y, last_y) in ((1.0 - keep, inner), (keep, outer)):
        fx, fy = (width - 1) / (last_x - first_x), (height - 1) / (last_y - first_y)
        bounds += share * np.array([fx, fy, -fx * first_x, -fy * first_y])
    fx, fy, cx, cy = bounds.tolist()
    return CameraModel(fx, fy, cx, cy, image_size)
