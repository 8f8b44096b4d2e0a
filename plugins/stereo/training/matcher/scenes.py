"""Random rectified pairs with exact disparity.

A scene is a list of layers, painted one over the other. A layer is a surface given by its disparity over the columns and rows of the left view, a
shape and a texture, all three functions of the left view's coordinates. The left view shows them as they are; the right view solves
`x - d(x, y) = x_right` for each. So truth and occlusion are exact in both views.
"""

from dataclasses import dataclass

import cv2
import numpy as np

# Steps that solve for the left column of a right column. The error falls at least by MAX_SLOPE with each.
STEPS = 6
# Largest change of disparity along a row, px per px.
MAX_SLOPE = 0.45


@dataclass
class Pair:
    """One rendered pair."""

    left: np.ndarray  # RGB, uint8, rows x columns x 3
    right: np.ndarray
    disparity: np.ndarray  # of the left view, float32, px, known everywhere
    visible: np.ndarray  # 1 where the right view shows the same point, uint8
    lit: np.ndarray  # 0 in the black rim of the left view, uint8


@dataclass
class Layer:
    """A surface over the coordinates of the left view, wider than it by the largest disparity."""

    disparity: np.ndarray  # px
    inside_px: np.ndarray  # distance from the edge of the shape, positive inside
    texture: np.ndarray  # gray, 0 to 1
    tint: np.ndarray  # exponent of the gray value for red, green and blue: black and white keep no colour


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def noise(rng, size, grain_px):
    """Smooth noise of mean 0 and deviation of about 1, with features of `grain_px`."""
    rows, columns = size
    small = rng.standard_normal((int(rows / grain_px) + 3, int(columns / grain_px) + 3)).astype(np.float32)
    # Exact weights: those of `warpAffine` have steps of 1/32 of the grain.
    large = cv2.resize(small, (int(small.shape[1] * grain_px), int(small.shape[0] * grain_px)), interpolation=cv2.INTER_CUBIC)
    y, x = (int(rng.integers(room + 1)) for room in (large.shape[0] - rows, large.shape[1] - columns))
    return 1.4 * large[y : y + rows, x : x + columns]


def fractal(rng, size, coarse_px, octaves, fall):
    """Noise of several sizes; each octave has `fall` times the strength of the coarser one."""
    total, weight = np.zeros(size, np.float32), 1.0
    for octave in range(octaves):
        grain = coarse_px / 2**octave
        if grain < 1.2:
            break
        total += weight * noise(rng, size, grain)
        weight *= fall
    return total / max(float(total.std()), 1e-6)


def grid(size):
    rows, columns = size
    return np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))


def texture(rng, size):
    """Gray values 0 to 1 of many kinds, from strong to none at all."""
    kind = rng.choice(["fractal", "grain", "vessels", "faint", "stripes", "flat"], p=[0.4, 0.15, 0.17, 0.15, 0.06, 0.07])
    mean, contrast = rng.uniform(0.12, 0.8), log_uniform(rng, 0.02, 0.3)
    if kind == "fractal":
        field = fractal(rng, size, log_uniform(rng, 6, 80), 6, rng.uniform(0.45, 0.9))
    elif kind == "grain":
        field = fractal(rng, size, rng.uniform(2, 6), 2, 0.7)
    elif kind == "vessels":
        lines = np.abs(noise(rng, size, log_uniform(rng, 12, 60)))
        field = -np.exp(-((lines / rng.uniform(0.05, 0.2)) ** 2)) + 0.3 * fractal(rng, size, 30, 4, 0.6)
        contrast = log_uniform(rng, 0.05, 0.3)
    elif kind == "faint":
        field = fractal(rng, size, log_uniform(rng, 20, 150), 5, rng.uniform(0.3, 0.6))
        contrast = log_uniform(rng, 0.005, 0.04)
    elif kind == "stripes":
        x, y = grid(size)
        angle, period = rng.uniform(0, np.pi), log_uniform(rng, 6, 50)
        field = np.tanh(3 * np.sin((x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi / period)) + 0.2 * noise(rng, size, 20)
    else:
        return np.full(size, mean, np.float32)
    if rng.random() < 0.3:  # Blood or char: dark patches that show little.
        patch = 1 / (1 + np.exp(-6 * (noise(rng, size, log_uniform(rng, 30, 120)) - rng.uniform(0.2, 1.2))))
        field = field * (1 - 0.9 * patch) - patch * rng.uniform(0.5, 2.0)
    return np.clip(mean + contrast * field, 0.0, 1.0).astype(np.float32)


def tissue(rng):
    """The tint of red, yellow or pale tissue, or of anything else."""
    if rng.random() < 0.15:
        return rng.uniform(0.7, 1.6, 3).astype(np.float32)
    red = rng.uniform(0.3, 0.9)
    green = rng.uniform(0.9, 1.7)
    return np.float32([red, green, green * rng.uniform(0.85, 1.3)])


def metal(rng):
    """The tint of metal and plastic: nearly gray."""
    return rng.uniform(0.85, 1.15, 3).astype(np.float32)


def limited(disparity):
    """The disparities with slopes along rows of at most `MAX_SLOPE`, and of at least 1 px."""
    steps = np.diff(disparity, axis=1)
    steepest = float(np.abs(steps).max(initial=0.0))
    if steepest > MAX_SLOPE:
        mean = disparity.mean()
        disparity = mean + (disparity - mean) * (MAX_SLOPE / steepest)
    return np.maximum(disparity, 1.0).astype(np.float32)


def surface(rng, size, base_px, spread_px):
    """A slope with bumps."""
    x, y = grid(size)
    rows, columns = size
    field = rng.normal(0, 0.5) * (x / columns - 0.5) + rng.normal(0, 0.5) * (y / rows - 0.5)
    field = field + rng.uniform(0, 0.35) * fractal(rng, size, log_uniform(rng, 40, 300), 3, rng.uniform(0.2, 0.5))
    return limited(base_px + spread_px * field)


def capsule(grids, start, end, radius_start, radius_end):
    """Distance from the edge of a rod, positive inside, and the position along it, 0 to 1."""
    x, y = grids
    across = np.float32([end[0] - start[0], end[1] - start[1]])
    length = max(float(across @ across), 1.0)
    along = np.clip(((x - start[0]) * across[0] + (y - start[1]) * across[1]) / length, 0, 1)
    distance = np.hypot(x - start[0] - along * across[0], y - start[1] - along * across[1])
    return (radius_start + (radius_end - radius_start) * along - distance).astype(np.float32), along


def rod_texture(rng, size, inside_px, radius):
    """Metal or plastic: a light that falls off to the sides, with a line of glare, and faint grain."""
    depth = np.clip(inside_px / max(radius, 1.0), 0, 1)
    glare = rng.uniform(0, 0.6) * np.exp(-(((depth - rng.uniform(0.5, 1.0)) / rng.uniform(0.05, 0.3)) ** 2))
    mean = rng.uniform(0.08, 0.75)
    grain = log_uniform(rng, 0.003, 0.05) * fractal(rng, size, log_uniform(rng, 2, 30), 3, 0.7)
    bands = 0.0
    if rng.random() < 0.3:
        x, y = grid(size)
        bands = rng.uniform(0.02, 0.2) * np.sign(np.sin((x + rng.uniform(-1, 1) * y) * 2 * np.pi / log_uniform(rng, 6, 40)))
    return np.clip(mean * (0.5 + 0.5 * depth) + glare + grain + bands, 0, 1).astype(np.float32)


def instrument(rng, size, view_columns, base_px):
    """A shaft from the border with two jaws."""
    rows, _ = size
    grids = grid(size)
    side = rng.integers(3)
    start = [(-20, rng.uniform(0, rows)), (view_columns + 20, rng.uniform(0, rows)), (rng.uniform(0, view_columns), rows + 20)][side]
    tip = (rng.uniform(0.2, 0.8) * view_columns, rng.uniform(0.15, 0.85) * rows)
    radius = log_uniform(rng, 4, 26)
    inside, along = capsule(grids, start, tip, radius * rng.uniform(0.9, 1.2), radius)
    ahead = np.arctan2(tip[1] - start[1], tip[0] - start[0])
    opening, length = rng.uniform(0, 0.7), radius * rng.uniform(1.5, 5)
    jaws = []
    for turn in (opening, -opening * rng.uniform(0, 1)):
        end = (tip[0] + length * np.cos(ahead + turn), tip[1] + length * np.sin(ahead + turn))
        jaws.append(capsule(grids, tip, end, radius * rng.uniform(0.3, 0.7), max(1.0, radius * rng.uniform(0.1, 0.4)))[0])
    whole = np.maximum(inside, np.maximum(*jaws))
    depth = base_px * (1 + rng.uniform(-0.1, 0.45) * (1 - along)) + 0.15 * np.sqrt(np.maximum(whole, 0) * radius)
    depth = cv2.GaussianBlur(depth.astype(np.float32), (0, 0), 3)
    return Layer(limited(depth), whole, rod_texture(rng, size, whole, radius), metal(rng))


def wire(rng, size, view_columns, base_px):
    """A thread, cable or rim of a hole."""
    x, y = grid(size)
    rows, _ = size
    width = log_uniform(rng, 0.8, 5)
    if rng.random() < 0.6:
        angle = rng.uniform(0, np.pi)
        along, off = x * np.cos(angle) + y * np.sin(angle), -x * np.sin(angle) + y * np.cos(angle)
        middle = off[int(rng.uniform(0, rows)) % rows, int(rng.uniform(0, view_columns)) % view_columns]
        bend = rng.uniform(0, 30) * np.sin(along * 2 * np.pi / log_uniform(rng, 80, 500) + rng.uniform(0, 6))
        inside = width - np.abs(off - middle - bend) * 0.8
    else:
        radius, centre = rng.uniform(15, 90), (rng.uniform(0, view_columns), rng.uniform(0, rows))
        inside = width - np.abs(np.hypot(x - centre[0], (y - centre[1]) * rng.uniform(0.5, 1.5)) - radius)
    inside = inside.astype(np.float32)
    return Layer(surface(rng, size, base_px, rng.uniform(0, 15)), inside, rod_texture(rng, size, inside, width), metal(rng))


def patch(rng, size, view_columns, base_px, spread_px):
    """A flap, organ or cut: any shape with an edge."""
    x, y = grid(size)
    rows, _ = size
    kind = rng.random()
    if kind < 0.4:
        grain = log_uniform(rng, 40, 200)
        inside = (noise(rng, size, grain) - rng.uniform(0.2, 1.2)) * grain * 0.4
    elif kind < 0.7:
        angle = rng.uniform(0, 2 * np.pi)
        middle = (rng.uniform(0.1, 0.9) * view_columns, rng.uniform(0.1, 0.9) * rows)
        inside = (x - middle[0]) * np.cos(angle) + (y - middle[1]) * np.sin(angle) + rng.uniform(0, 12) * noise(rng, size, 40)
    else:
        middle, radius = (rng.uniform(0, view_columns), rng.uniform(0, rows)), log_uniform(rng, 12, 120)
        inside = radius - np.hypot(x - middle[0], (y - middle[1]) * rng.uniform(0.4, 1.6)) + rng.uniform(0, 8) * noise(rng, size, 30)
    return Layer(surface(rng, size, base_px, spread_px), inside.astype(np.float32), texture(rng, size), tissue(rng))


def layers(rng, size, view_columns, max_px):
    """Background first, then what stands before it."""
    base = log_uniform(rng, 3, 0.6 * max_px)
    spread = log_uniform(rng, 0.04, 0.8) * base + rng.uniform(0, 4)
    made = [Layer(surface(rng, size, base, spread), np.full(size, 9.0, np.float32), texture(rng, size), tissue(rng))]
    near = float(made[0].disparity.max())
    for _ in range(rng.integers(0, 5)):
        jump = min(log_uniform(rng, 1.0, 60), 0.8 * max_px - near)
        if jump < 1:
            break
        near += jump * rng.uniform(0.3, 1.0)
        kind = rng.random()
        if kind < 0.35:
            made.append(instrument(rng, size, view_columns, near))
        elif kind < 0.5:
            made.append(wire(rng, size, view_columns, near))
        else:
            made.append(patch(rng, size, view_columns, near, rng.uniform(0, 0.3) * spread))
    for layer in made:
        np.minimum(layer.disparity, max_px, out=layer.disparity)
    return made


def paint(made, shape, columns_of=None):
    """Gray, disparity and number of the layer of each pixel; `columns_of` gives the left columns that a layer is looked up at."""
    rows, columns = shape
    gray, disparity, index = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.int8)
    _, y = grid(shape)
    for number, layer in enumerate(made):
        if columns_of is None:
            found = [plane[:, :columns] for plane in (layer.disparity, layer.inside_px, layer.texture)]
        else:
            x = columns_of(layer)
            look = lambda plane, how: cv2.remap(plane, x, y, how, borderMode=cv2.BORDER_REPLICATE)
            found = [look(layer.disparity, cv2.INTER_LINEAR), look(layer.inside_px, cv2.INTER_LINEAR), look(layer.texture, cv2.INTER_CUBIC)]
        cover = np.clip(found[1] + 0.5, 0, 1)
        gray += cover * (found[2] - gray)
        seen = cover >= 0.5
        disparity[seen], index[seen] = found[0][seen], number
    return gray, disparity, index


def falling_light(rng, disparity):
    """Light that falls off with the distance, as that of a lamp beside the lens does: far walls are dark."""
    power = rng.uniform(0.3, 2.0)
    bright = float(np.quantile(disparity[0][::4, ::4], rng.uniform(0.5, 1.0)))
    return [np.clip(plane / max(bright, 1.0), 0.02, 1.5) ** power for plane in disparity]


def shade(rng, other):
    """A region that little light reaches, on the surfaces of both views."""
    rows, columns = other.shape
    x, y = grid(other.shape)
    wide = (rows, 2 * columns)
    depth = log_uniform(rng, 0.01, 0.3)
    field = 1 / (1 + np.exp(-rng.uniform(2, 10) * (noise(rng, wide, log_uniform(rng, 60, 250)) - rng.uniform(-0.5, 1))))
    field = 1 - (1 - depth) * field
    return field[:, :columns], cv2.remap(field, x + other, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def highlights(rng, left, right, disparity):
    """Saturated spots that do not stick to the surface."""
    rows, columns = left.shape
    x, y = grid(left.shape)
    for _ in range(rng.integers(1, 14)):
        at = (rng.uniform(0, columns), rng.uniform(0, rows))
        long, flat, turn = log_uniform(rng, 1, 14), rng.uniform(0.2, 1), rng.uniform(0, np.pi)
        d = disparity[min(int(at[1]), rows - 1), min(int(at[0]), columns - 1)] + rng.normal(0, 3)
        for view, shift in ((left, 0.0), (right, d)):
            if rng.random() < 0.12:
                continue
            u, v = x - at[0] + shift, y - at[1]
            a, b = u * np.cos(turn) + v * np.sin(turn), -u * np.sin(turn) + v * np.cos(turn)
            view += rng.uniform(0.4, 1.5) * np.exp(-((a / long) ** 2 + (b / (long * flat)) ** 2))


def disturb(rng, left, right, disparity, other):
    """What light, optics and cameras do, to each view by itself."""
    shape = left.shape
    rows, columns = shape
    light = 1 + rng.uniform(0, 0.35) * noise(rng, (rows, columns), 150)
    left *= light
    right *= light + rng.uniform(0, 0.05) * noise(rng, shape, 120)
    if rng.random() < 0.35:
        for view, fall in zip((left, right), falling_light(rng, (disparity, other))):
            view *= fall
    if rng.random() < 0.3:
        for view, fall in zip((left, right), shade(rng, other)):
            view *= fall
    if rng.random() < 0.5:
        highlights(rng, left, right, disparity)
    if rng.random() < 0.3:
        wide = (rows, columns + 64)
        veil = np.clip(0.5 + 0.5 * fractal(rng, wide, 200, 4, 0.6), 0, 1) * rng.uniform(0.1, 0.75)
        shift, white = rng.integers(0, 60), rng.uniform(0.4, 0.9)
        for view, at in ((left, 0), (right, shift)):
            part = veil[:, at : at + columns]
            view += part * (white - view)
    x, y = grid(shape)
    vignette = rng.uniform(0, 0.9) if rng.random() < 0.5 else 0.0
    fall = 1 - vignette * (((x / columns - 0.5) ** 2 + (y / rows - 0.5) ** 2) * 2).clip(0, 1)
    dark = log_uniform(rng, 0.05, 0.5) if rng.random() < 0.25 else 1.0
    gain = np.exp(rng.normal(0, 0.15, 2)) if rng.random() < 0.7 else np.ones(2)
    offset = rng.normal(0, 0.02, 2)
    drift = rng.uniform(-1, 1) if rng.random() < 0.4 else 0.0
    turn = np.deg2rad(rng.normal(0, 0.05)) if drift else 0.0
    move = np.float32([[1, 0, 0], [np.sin(turn), 1, drift - np.sin(turn) * columns / 2]])
    right[:] = cv2.warpAffine(right, move, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    blur = log_uniform(rng, 0.4, 1.8) if rng.random() < 0.5 else 0.0
    grain = log_uniform(rng, 0.002, 0.03)
    made = []
    for number, view in enumerate((left, right)):
        sigma = blur * rng.uniform(0.8, 1.2)
        if sigma > 0.3:
            view = cv2.GaussianBlur(view, (0, 0), sigma)
        view = (view * fall * dark * gain[number] + offset[number] * dark).clip(0, 1.2)
        view = view + grain * (0.4 + view) * rng.standard_normal(shape, dtype=np.float32)
        made.append(view)
    return made


def rim(rng, shape):
    """What of a view is lit: a round or cut picture in a black border."""
    rows, columns = shape
    x, y = grid(shape)
    kind = rng.random()
    if kind < 0.6:
        radius = rng.uniform(0.42, 0.62) * columns
        centre = (columns * rng.uniform(0.47, 0.53), rows * rng.uniform(0.47, 0.53))
        return np.hypot(x - centre[0], y - centre[1]) < radius
    low, high = rng.uniform(0, 0.12, 2), 1 - rng.uniform(0, 0.12, 2)
    return (x > low[0] * columns) & (x < high[0] * columns) & (y > low[1] * rows) & (y < high[1] * rows)


def coloured(view, index, made, rng):
    """RGB of a gray view by the tints of its layers, with a white balance of its own."""
    steps = np.linspace(0, 1, 256, dtype=np.float32)
    tables = np.stack([steps[:, None] ** layer.tint for layer in made])
    gray = view.clip(0, 1)
    low = np.minimum((gray * 255).astype(np.int32), 254)
    part = (gray * 255 - low)[..., None]
    rgb = tables[index, low] * (1 - part) + tables[index, low + 1] * part
    return rgb * np.exp(rng.normal(0, 0.03, 3)).astype(np.float32)


def to_bytes(view, rng):
    rgb = np.rint(view * 255).clip(0, 255).astype(np.uint8)
    if rng.random() < 0.2:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(45, 95))]
        rgb = cv2.imdecode(cv2.imencode(".jpg", rgb, quality)[1], cv2.IMREAD_COLOR)
    return rgb


def render(seed, rows=336, columns=448):
    """The pair of a seed: the same on every machine with the same NumPy and OpenCV."""
    rng = np.random.default_rng(seed)
    max_px = int(0.4 * columns)
    wide = (rows, columns + max_px + 8)
    made = layers(rng, wide, columns, max_px)
    left, disparity, index = paint(made, (rows, columns))
    x, y = grid((rows, columns))

    def columns_of(layer):
        at = x + layer.disparity[:, :columns]
        for _ in range(STEPS):
            at = x + cv2.remap(layer.disparity, at, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return at

    right, other, other_index = paint(made, (rows, columns), columns_of)
    to = x - disparity
    near = lambda plane: cv2.remap(plane, to, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=-1)
    same = (near(other_index.astype(np.float32)) == index) & (np.abs(near(other) - disparity) < 1.5)
    visible = same & (to >= 0)
    views = disturb(rng, left, right, disparity, other)
    views = [coloured(view, which, made, rng) for view, which in zip(views, (index, other_index))]
    lit = np.ones((rows, columns), bool)
    if rng.random() < 0.4:
        lit = rim(rng, (rows, columns))
        black = rng.uniform(0, 0.02)
        move = np.float32([[1, 0, rng.uniform(-25, 25)], [0, 1, rng.uniform(-2, 2)]])
        other_lit = cv2.warpAffine(lit.astype(np.uint8), move, (columns, rows)) > 0
        for view, part in zip(views, (lit, other_lit)):
            view[~part] = black + 0.004 * rng.standard_normal((int((~part).sum()), 3))
    left, right = (to_bytes(view, rng) for view in views)
    return Pair(left, right, disparity, visible.astype(np.uint8), lit.astype(np.uint8))
