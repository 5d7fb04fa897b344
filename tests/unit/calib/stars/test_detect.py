"""Stars in images of the target: all complete ones, no wrong one, as accurate as their covariances say."""

from functools import cache

import cv2
import numpy as np
import pytest
from slow_cases import first_quick

from calib.errors import InputMismatch, TargetNotFound, TooFewStars
from calib.events.grey_image import to_uint8
from calib.model.homography import apply_homography
from calib.stars import tag as tag_module
from calib.stars.detect import detect_stars, detect_view
from calib.stars.pointing import grid_homography
from calib.stars.tag import find_tag
from calib.target import StarTarget

TARGET = StarTarget()
SIZE = (560, 440)


class Scene:
    """A camera in front of the target, rendered with OpenCV's projection only."""

    def __init__(
        self,
        *,
        pitch_px=40.0,
        tilts=(4.0, -3.0),
        roll=0.0,
        disc_px=None,
        k=(0.06, -0.9),
        size=SIZE,
        shift=(0, 0),
    ):
        self.size, self.disc_px, self.k = size, disc_px, np.array([*k, 0.0, 0.0])
        f, r = 2500.0, 2500.0 * TARGET.pitch_mm / pitch_px
        middle = size[0] / 2 - 3.3 + shift[0], size[1] / 2 + 2.1 + shift[1]
        self.matrix = np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]])
        angles = np.deg2rad([*tilts, roll])
        self.turn = cv2.Rodrigues(angles[2] * np.array([0, 0, 1.0]))[0]
        self.turn = self.turn @ cv2.Rodrigues(np.array([angles[0], angles[1], 0.0]))[0]
        x, y = TARGET.tag_centre_mm
        middle = np.array([x + 0.7, y - 0.4, 0.0])
        self.shift = np.array([0, 0, r]) - self.turn @ middle

    def project(self, mm):
        world = np.column_stack([mm, np.zeros(len(mm))])
        return cv2.projectPoints(world, cv2.Rodrigues(self.turn)[0], self.shift, self.matrix, self.k)[0][:, 0]

    def draw(self, samples=7, blur=0.7, black=0.1):
        """Return the image, float32: black to 1 inside of the disc, 0 outside."""
        image = np.zeros((self.size[1], self.size[0]), np.float32)
        pixels = np.stack(np.meshgrid(*(np.arange(float(n)) for n in self.size)), axis=-1).reshape(-1, 2)
        plane = np.linalg.inv(np.column_stack([self.turn[:, :2], self.shift]))
        for i in range(samples):
            # No two samples of a pixel share a column or row, so that edges along these are averaged as well.
            at = pixels + np.array([i + 0.5, (5 * i + 2) % samples + 0.5]) / samples - 0.5
            rays = cv2.undistortPoints(at[:, None], self.matrix, self.k)[:, 0]
            on_plane = cv2.perspectiveTransform(rays[None], plane)[0]
            value = black + (1 - black) * TARGET.reflectance(on_plane[:, 0], on_plane[:, 1])
            image += (value * self.lit(at)).reshape(image.shape).astype(np.float32) / samples
        return cv2.GaussianBlur(image, (0, 0), blur)

    def lit(self, pixels):
        """Return the light of the disc at image points: 1 inside, falling to 0 over its outer twelfth."""
        if self.disc_px is None:
            return np.ones(len(pixels))
        distance = np.linalg.norm(pixels - np.array(self.size) / 2, axis=1) / self.disc_px
        return np.clip((1.0 - distance) * 12.0, 0.0, 1.0)

    def whole_stars(self, margin=0.72):
        """Return ids and image points of the stars whose cells lie completely in the frame and the disc."""
        ids = TARGET.ids
        mm = TARGET.positions_mm(ids)
        corners = np.array([self.project(mm + margin * TARGET.pitch_mm * np.array(c)) for c in _CORNERS])
        inside = ((corners > 2) & (corners < np.array(self.size) - 3)).all(axis=(0, 2))
        # Far from the axis the lens model folds back into the frame.
        inside &= np.linalg.norm(mm - TARGET.tag_centre_mm, axis=1) < 0.3 * self.shift[2]
        inside &= np.array([self.lit(c) >= 1.0 for c in corners]).all(axis=0)
        return ids[inside], self.project(mm[inside])


@cache
def drawn(**settings):
    """Return a scene and its image; they are kept, because rendering takes most of the time."""
    scene = Scene(**settings)
    image = scene.draw()
    image.setflags(write=False)
    return scene, image


_CORNERS = [(-0.7, -0.7), (0.7, -0.7), (0.7, 0.7), (-0.7, 0.7)]


def as_events_show_it(image, rng, *, mismatch=0.12, stray=0.02):
    """Return the binary image that pixels with a threshold make, with mismatch and stray events."""
    fired = image > 0.25 * np.exp(mismatch * rng.standard_normal(image.shape))
    return np.where(rng.random(image.shape) < stray, rng.random(image.shape) < 0.5, fired).astype(np.float32)


def assert_found_where_drawn(view, scene, *, rms_px, share=0.995):
    """Assert that no star is wrong, nearly all are found, and the rms is met; return the normalised squares."""
    off = view.points_px - scene.project(TARGET.positions_mm(view.ids))
    assert np.abs(off).max() < 0.35
    whole, _ = scene.whole_stars()
    assert np.isin(whole, view.ids).mean() >= share
    assert np.sqrt((off**2).mean()) <= rms_px
    return np.einsum("ni,nij,nj->n", off, np.linalg.inv(view.covariances_px2), off) / 2


@pytest.mark.parametrize("roll", first_quick([37, 143, 2, 93, 200, 271], 2))
@pytest.mark.parametrize("bright", [True, False])
def test_stars_are_found_at_any_roll_and_either_contrast(roll, bright):
    scene, image = drawn(roll=roll)
    detection = detect_stars(image if bright else 1.0 - image, TARGET, name="p")
    assert_found_where_drawn(detection.view, scene, rms_px=0.008)
    assert detection.named_by == "tag"
    assert detection.view.image_size == SIZE
    assert (np.diff(detection.view.ids) > 0).all()


def test_views_without_a_name_are_named_apart_and_always_the_same():
    images = [drawn(roll=roll)[1] for roll in (2, 37, 2)]
    first, second, again = (detect_view(image, TARGET).name for image in images)
    assert first == again != second
    assert detect_view(images[0], TARGET, name="left").name == "left"


@pytest.mark.parametrize("pitch", [20, 28, 55, 80])
def test_stars_are_found_small_and_large(pitch):
    scene, image = drawn(pitch_px=pitch, roll=12, size=(400, 320) if pitch < 40 else (800, 640))
    assert_found_where_drawn(detect_view(image, TARGET), scene, rms_px=0.012)


@pytest.mark.parametrize(
    ("kind", "scale", "black"),
    [
        *((np.uint8, 200, 0), (np.uint16, 60_000, 0), (np.int32, 900, 0), (np.float64, 1e-3, 0)),
        *((np.float32, 1e-9, 0), (np.float32, 1e9, 0), (np.float32, 100, 1e4)),
    ],
)
def test_grey_values_may_be_of_any_type_and_size_and_on_any_pedestal(kind, scale, black):
    scene, image = drawn(roll=37)
    shown = (image * np.float32(scale) + np.float32(black)).astype(kind)
    assert_found_where_drawn(detect_view(shown, TARGET), scene, rms_px=0.008, share=0.98)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("roll", [37, 200])
def test_covariances_say_how_surely_stars_are_placed_in_binary_images(seed, roll):
    scene, image = drawn(roll=roll)
    rng = np.random.default_rng(seed)
    squares = assert_found_where_drawn(detect_view(as_events_show_it(image, rng), TARGET), scene, rms_px=0.06)
    assert 0.75 < np.sqrt(squares.mean()) < 1.3


def photograph(image, rng, *, bits, electrons=4000, gamma=1.0, contrast=1.0):
    """What a frame camera makes of an image: shot and read noise, a tone curve, so many bits."""
    light = 0.06 + contrast * 0.7 * image + (1 - contrast) * 0.35
    counted = (rng.poisson(light * electrons) + 8 * rng.standard_normal(image.shape)) / electrons
    grey = np.clip(counted, 0, 1) ** gamma * (2**bits - 1)
    return np.round(grey).astype(np.uint8 if bits == 8 else np.uint16)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    ("settings", "rms_px"),
    [({}, 0.008), ({"gamma": 1 / 2.2}, 0.008), ({"electrons": 400}, 0.016), ({"contrast": 0.15}, 0.02)],
    ids=["plain", "gamma", "dark", "dull"],
)
def test_photographs_do_as_well_as_their_noise_lets_them(bits, settings, rms_px):
    scene, image = drawn(roll=37)
    shown = photograph(image, np.random.default_rng(6), bits=bits, **settings)
    squares = assert_found_where_drawn(detect_view(shown, TARGET), scene, rms_px=rms_px)
    assert 0.75 < np.sqrt(squares.mean()) < 1.6


def test_stars_cut_by_the_discs_rim_are_left_out():
    scene = Scene(roll=31, disc_px=240)
    view = detect_view(scene.draw(), TARGET)
    assert_found_where_drawn(view, scene, rms_px=0.02)
    light = scene.lit(scene.project(TARGET.positions_mm(view.ids)))
    assert (light > 0.3).all()


def test_stars_cut_by_the_frame_are_left_out():
    _, image = drawn(roll=2)
    points = detect_view(image, TARGET).points_px
    assert len(points) > 100
    assert (points > 12).all()
    assert (points < np.array(SIZE) - 13).all()


def test_a_blot_on_the_target_costs_the_stars_below_it_and_no_others():
    scene, clean = drawn(roll=143)
    image = clean.copy()
    cv2.circle(image, (150, 130), 50, 0.4, -1)
    view = detect_view(image, TARGET)
    whole, points = scene.whole_stars()
    clear = np.linalg.norm(points - [150, 130], axis=1) > 50 + 30
    assert np.isin(whole[clear], view.ids).mean() > 0.99
    off = np.linalg.norm(view.points_px - scene.project(TARGET.positions_mm(view.ids)), axis=1)
    assert off.max() < 0.3
    assert not np.isin(whole[np.linalg.norm(points - [150, 130], axis=1) < 40], view.ids).any()


def expected_homography(scene, nodes_off=(0.0, 0.0)):
    """Return the homography expected by a pose, from the target's grid to the image, with an error in nodes."""
    ids, points = scene.whole_stars()
    return cv2.findHomography(TARGET.node_of(ids) + np.array(nodes_off), points)[0]


@pytest.mark.parametrize(
    ("roll", "shift"),
    first_quick([(20, (230, 0)), (213, (-220, 20)), (20, (10, 180)), (213, (0, -170)), (110, (210, 150))], 2),
)
def test_part_of_the_tag_is_enough(roll, shift):
    scene, image = drawn(roll=roll, shift=shift)
    seen = detect_stars(as_events_show_it(image, np.random.default_rng(1)), TARGET)
    assert find_tag(to_uint8(image), TARGET) is None, "the tag is not meant to be readable"
    assert seen.named_by == "part of the tag"
    assert_found_where_drawn(seen.view, scene, rms_px=0.05)


@pytest.mark.parametrize(("shift", "cut"), [((370, 0), True), ((0, 0), False)])
def test_a_tag_that_is_cut_is_not_searched_in_pictures_of_full_size(monkeypatch, shift, cut):
    """They take four fifths of the time of the search. A tag that is whole, but cannot be read, is searched in all."""
    scene, clean = drawn(roll=20, pitch_px=48.0, size=(800, 700), shift=shift)
    image = clean.copy()
    if not cut:
        cv2.circle(image, scene.project(TARGET.tag_corners_mm)[0].round().astype(int).tolist(), 30, 0.5, -1)
    searched = []
    real = tag_module.read_tags
    monkeypatch.setattr(tag_module, "read_tags", lambda *given: searched.append(given[1]) or real(*given))
    seen = detect_stars(image, TARGET)
    assert seen.named_by == "part of the tag"
    assert min(searched) == 0.25
    assert (max(searched) < 1.0) == cut


def out_of_focus(blur_px):
    """Return a scene, and what a square flicker shows of it with a lens out of focus: white but for some black."""
    scene, _ = drawn(roll=16, pitch_px=53.0, size=(700, 560))
    image = scene.draw(blur=blur_px, black=0.0)
    fired = image > 0.06 * np.exp(0.12 * np.random.default_rng(3).standard_normal(image.shape))
    return scene, fired.astype(np.float32)


@pytest.mark.parametrize(("blur_px", "rms_px"), first_quick([(0.7, 0.03), (1.5, 0.06), (1.75, 0.09)]))
def test_stars_out_of_focus_are_found_and_the_width_of_their_edges_is_measured(blur_px, rms_px):
    scene, image = out_of_focus(blur_px)
    seen = detect_stars(image, TARGET)
    squares = assert_found_where_drawn(seen.view, scene, rms_px=rms_px)
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.5
    assert 0.7 * blur_px < seen.edge_width_px < 1.1 * np.hypot(blur_px, 0.3)


def test_an_image_too_far_out_of_focus_is_refused():
    _, image = out_of_focus(2.6)
    with pytest.raises((TooFewStars, TargetNotFound), match="focus"):
        detect_view(image, TARGET)


def test_without_the_tag_stars_are_not_labelled():
    _, image = drawn(roll=61, shift=(390, 0))
    with pytest.raises(TargetNotFound, match="no readable part"):
        detect_view(image, TARGET)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_picture_is_told_as_such(axis):
    _, image = drawn(roll=20, pitch_px=48.0, size=(800, 700))
    with pytest.raises(TargetNotFound, match="as in a mirror"):
        detect_view(np.flip(image, axis), TARGET)


@pytest.mark.parametrize("bright", [True, False])
@pytest.mark.parametrize("off", [(0.0, 0.0), (0.25, -0.2)])
def test_without_the_tag_the_expected_pose_labels_the_stars(off, bright):
    scene, image = drawn(roll=61, shift=(390, 0))
    seen = detect_stars(image if bright else 1 - image, TARGET, expected=expected_homography(scene, off))
    assert seen.named_by == "expected pose"
    assert_found_where_drawn(seen.view, scene, rms_px=0.008)


def test_a_known_collimator_and_camera_give_the_expected_grid():
    scene = Scene(roll=61, shift=(390, 0), k=(0.0, 0.0))
    centre = -scene.turn.T @ scene.shift
    grid = grid_homography(scene.matrix, scene.turn, centre, TARGET.pitch_mm)
    nodes = np.array([[20.0, 30.0], [25.0, 36.0], [28.0, 33.0]])
    assert apply_homography(grid, nodes) == pytest.approx(scene.project(nodes * TARGET.pitch_mm), abs=1e-6)


@pytest.mark.parametrize(
    ("roll", "off"),
    [
        pytest.param(61, (0.5, 0.0), id="between two columns"),
        pytest.param(61, (0.1, -0.4), id="between two rows"),
        pytest.param(80, (0.0, 0.0), id="of another roll"),
    ],
)
def test_an_expected_pose_that_may_be_of_other_stars_is_refused(roll, off):
    _, image = drawn(roll=61, shift=(390, 0))
    with pytest.raises(TargetNotFound, match="does not identify"):
        detect_view(image, TARGET, expected=expected_homography(Scene(roll=roll, shift=(390, 0)), off))


def test_a_target_without_room_for_the_stars_seen_is_refused():
    scene, image = drawn(roll=61, shift=(390, 0))
    small = StarTarget(squares_x=12, squares_y=12, tag_square=(4, 4))
    with pytest.raises(TargetNotFound):
        detect_view(image, small, expected=expected_homography(scene))


def covered(image, centre):
    """Cover a part of a star evenly, so that nothing but the missing contrast tells."""
    for side in (16, -16):
        spot = centre + side * np.array([np.cos(0.3), np.sin(0.3)])
        cv2.circle(image, tuple(spot.round().astype(int).tolist()), 8, 0.55, -1)


def moved(image, centre):
    """Move a star by a pixel."""
    x, y = centre.round().astype(int)
    image[y - 19 : y + 20, x - 18 : x + 21] = image[y - 19 : y + 20, x - 19 : x + 20].copy()


@pytest.mark.parametrize("spoil", [covered, moved])
def test_a_star_that_is_covered_in_part_or_out_of_line_is_left_out(spoil):
    scene, clean = drawn(roll=143)
    star, centre = next(
        (i, p) for i, p in zip(*scene.whole_stars(), strict=True) if np.linalg.norm(p - [150, 130]) < 30
    )
    image = clean.copy()
    spoil(image, centre)
    assert star in detect_view(clean, TARGET).ids
    assert star not in detect_view(image, TARGET).ids


NONE = "view p7: Tag 3 of family 36h11 is not in the image"


@pytest.mark.parametrize(
    ("image", "tag_id", "error", "fault"),
    [
        (lambda: np.zeros((400, 500)), 3, TargetNotFound, NONE),
        (lambda: np.full((400, 500), np.nan), 3, TargetNotFound, NONE),
        (lambda: np.eye(300), 3, TargetNotFound, NONE),
        (lambda: np.zeros((40, 50, 3)), 3, InputMismatch, "one grey plane"),
        (lambda: drawn(roll=200)[1], 8, TargetNotFound, "tags seen instead: 3"),
        (lambda: drawn(roll=20, shift=(230, 0))[1], 8, TargetNotFound, None),
        (lambda: np.hstack([drawn(roll=37)[1]] * 2), 3, TargetNotFound, "seen 2 times"),
    ],
    ids=["black", "nan", "line", "colours", "another tag", "part of another", "two targets"],
)
def test_an_image_without_the_target_is_refused(image, tag_id, error, fault):
    with pytest.raises(error, match=fault):
        detect_view(image(), StarTarget(tag_id=tag_id), name="p7")


def test_a_tag_without_stars_around_it_is_refused():
    scene, image = drawn(roll=37)
    hull = scene.project(TARGET.tag_corners_mm + np.array(_CORNERS) / 0.7 * 0.4 * TARGET.pitch_mm)
    mask = np.zeros(image.shape, np.uint8)
    cv2.fillConvexPoly(mask, hull.round().astype(np.int32), 1)
    with pytest.raises(TooFewStars, match="0 stars"):
        detect_view(np.where(mask > 0, image, np.float32(1)), TARGET)


def test_the_tags_contrast_and_corners_are_told():
    scene, image = drawn(roll=93)
    seed = find_tag(to_uint8(1 - image), TARGET)
    assert seed.sign == -1
    assert np.abs(seed.corners_px - scene.project(TARGET.tag_corners_mm)).max() < 1.5
