// What is drawn over the live picture: stars, tag, the beam's disc, the centre and the five regions of the focus.

const COLOURS = { star: "#39d98a", unknown: "#ffb020", tag: "#4cc3ff", disc: "#ff7ad9", grid: "rgb(255 255 255 / 0.8)", shade: "rgb(0 60 120 / 0.8)" };

/** Draw the figures over the picture. The canvas is as large as the picture on the screen. */
export function draw(canvas, figures, shows) {
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const key = JSON.stringify([width, height, shows, figures.width_px, figures.stars, figures.tag_corners_px, figures.square, figures.disc_centre_px, figures.disc_radius_px]);
  if (canvas.dataset.drawn === key) return; // what lies over the picture changes less often than the picture
  canvas.dataset.drawn = key;
  const c = canvas.getContext("2d");
  c.clearRect(0, 0, width, height);
  if (!figures.width_px || !figures.height_px) return;
  const sx = width / figures.width_px, sy = height / figures.height_px;
  const x = (u) => (u + 0.5) * sx, y = (v) => (v + 0.5) * sy; // a pixel's centre is at a whole number
  c.lineWidth = 1.5 * ratio;
  if (shows.grid) grid(c, width, height, ratio);
  if (shows.disc && figures.disc_centre_px) disc(c, figures, x, y, sx, ratio);
  if (shows.stars) stars(c, figures, x, y, ratio);
  if (shows.tag && figures.tag_corners_px) tag(c, figures, x, y, ratio);
  if (shows.tag && !figures.tag_corners_px && figures.square) square(c, figures.square, x, y, sx, ratio);
}

/** Light dashes between dark ones, so that the lines show on any picture. */
function grid(c, width, height, ratio) {
  for (const [colour, offset] of [[COLOURS.shade, 0], [COLOURS.grid, 5]]) {
    c.strokeStyle = colour;
    c.setLineDash([5 * ratio, 5 * ratio]);
    c.lineDashOffset = offset * ratio;
    c.beginPath();
    c.moveTo(width / 2, 0); c.lineTo(width / 2, height);
    c.moveTo(0, height / 2); c.lineTo(width, height / 2);
    c.stroke();
  }
  c.setLineDash([]);
}

function disc(c, figures, x, y, scale, ratio) {
  const [u, v] = figures.disc_centre_px, radius = figures.disc_radius_px;
  c.strokeStyle = COLOURS.disc;
  if (typeof radius === "number") {
    c.beginPath();
    c.arc(x(u), y(v), radius * scale, 0, 2 * Math.PI);
    c.stroke();
  }
  cross(c, x(u), y(v), 9 * ratio);
}

/** All stars of a colour are one path: hundreds of single strokes take longer than the picture itself. */
function stars(c, figures, x, y, ratio) {
  const size = (figures.stars.length > 400 ? 3 : 4.5) * ratio;
  for (const named of [true, false]) {
    c.strokeStyle = named ? COLOURS.star : COLOURS.unknown;
    c.beginPath();
    for (const [id, u, v] of figures.stars) if ((id >= 0) === named) crossPath(c, x(u), y(v), size);
    c.stroke();
  }
}

function tag(c, figures, x, y, ratio) {
  c.strokeStyle = COLOURS.tag;
  c.lineWidth = 2.5 * ratio;
  c.beginPath();
  figures.tag_corners_px.forEach(([u, v], i) => (i ? c.lineTo(x(u), y(v)) : c.moveTo(x(u), y(v))));
  c.closePath();
  c.stroke();
  const [u, v] = figures.tag_corners_px[0];
  label(c, "tag", x(u), y(v), ratio);
}

/** A dark square that is probably the tag: dashed, and round, because its roll is not known. */
function square(c, found, x, y, scale, ratio) {
  const [u, v] = found.centre_px, half = found.side_px / 2;
  c.strokeStyle = COLOURS.tag;
  c.lineWidth = 2 * ratio;
  c.setLineDash([7 * ratio, 5 * ratio]);
  c.beginPath();
  c.arc(x(u), y(v), half * Math.SQRT2 * scale, 0, 2 * Math.PI);
  c.stroke();
  c.setLineDash([]);
  cross(c, x(u), y(v), 7 * ratio);
}

function label(c, text, x, y, ratio) {
  c.fillStyle = COLOURS.tag;
  c.strokeStyle = "rgb(0 0 0 / 0.75)";
  c.lineWidth = 3 * ratio;
  c.font = `600 ${13 * ratio}px system-ui, sans-serif`;
  c.strokeText(text, x, y - 6 * ratio);
  c.fillText(text, x, y - 6 * ratio);
}

function cross(c, x, y, size) {
  c.beginPath();
  crossPath(c, x, y, size);
  c.stroke();
}

function crossPath(c, x, y, size) {
  c.moveTo(x - size, y); c.lineTo(x + size, y);
  c.moveTo(x, y - size); c.lineTo(x, y + size);
}
