"""Endoscopic pictures without instruments: tubes with folds and cavities with bulges, drawn by marching rays through a distance field."""

import cv2
import numpy as np

#: Marching steps, and the side of the volume of noise.
STEPS, SIDE = 56, 32


class Noise:
    """Smooth random values in space, -1 to 1, the same for the same generator."""

    def __init__(self, rng):
        self.values = rng.uniform(-1, 1, SIDE**3).astype(np.float32)

    def __call__(self, p):
        cell = np.floor(p).astype(np.int32)
        t = p - cell
        t = t * t * (3 - 2 * t)
        lows, highs = [(cell[..., k] % SIDE) for k in range(3)], [((cell[..., k] + 1) % SIDE) for k in range(3)]
        out = 0.0
        for corner in range(8):
            picks = [(highs if corner >> k & 1 else lows)[k] for k in range(3)]
            share = np.prod([t[..., k] if corner >> k & 1 else 1 - t[..., k] for k in range(3)], axis=0)
            out = out + share * self.values[(picks[0] * SIDE + picks[1]) * SIDE + picks[2]]
        return out


class Cavity:
    """A tube along z that bends, with folds across it (colon), or a flat passage with bulges (nose, sinus)."""

    def __init__(self, rng):
        self.noise = Noise(rng)
        self.is_tube = rng.random() < 0.5
        self.bend = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.1, 0.35, 2), rng.uniform(0, 6, 2)
        self.folds = rng.uniform(0.05, 0.4) if self.is_tube else rng.uniform(0, 0.08)
        self.pitch, self.sharp = rng.uniform(1.0, 2.6), rng.uniform(1, 6)
        self.lobes = int(rng.integers(2, 5)), rng.uniform(0, 0.3), rng.uniform(0, 6)
        self.flat = 1.0 if self.is_tube else rng.uniform(0.35, 0.9)
        self.rough = rng.uniform(0.02, 0.3), rng.uniform(1, 4)
        count = 0 if self.is_tube and rng.random() < 0.7 else int(rng.integers(1, 7))
        angle, depth = rng.uniform(0, 6.3, count), rng.uniform(0.6, 5, count)
        self.bulges = [
            (np.array([np.cos(a), np.sin(a) * self.flat, z]), r) for a, z, r in zip(angle, depth, rng.uniform(0.2, 0.8, count))
        ]
        self.end = rng.uniform(4, 12)

    def inside(self, p):
        """Distance to the wall, about; below 0 beyond it."""
        amplitude, rate, phase = self.bend
        centre = amplitude * (np.sin(p[..., 2:] * rate + phase) - np.sin(phase))
        x, y = p[..., 0] - centre[..., 0], (p[..., 1] - centre[..., 1]) / self.flat
        around, z = np.arctan2(y, x), p[..., 2]
        wave = 0.5 + 0.5 * np.cos(2 * np.pi * z / self.pitch + 0.6 * np.sin(around + z))
        count, depth, turn = self.lobes
        radius = 1 - self.folds * wave**self.sharp * (1 + depth * np.cos(count * around + turn)) - 0.5 * depth * np.cos(count * around)
        d = (radius - np.hypot(x, y)) * self.flat * 0.7
        high, rate = self.rough
        d = d + high * 0.5 * self.noise(p * rate)
        for centre, radius in self.bulges:
            off = np.linalg.norm(p - centre, axis=-1) - radius
            h = np.clip(0.5 + (off - d) / 0.3, 0, 1)
            d = off * (1 - h) + d * h - 0.15 * h * (1 - h)
        return np.minimum(d, self.end - z)


def march(cavity, rays, origin):
    """Points where rays from `origin` meet the wall, with their distance."""
    far = np.full(rays.shape[:2], 0.02, np.float32)
    for _ in range(STEPS):
        far += np.clip(cavity.inside(origin + far[..., None] * rays), -0.05, 0.6)
    return origin + far[..., None] * rays, far


def normals(points):
    """Normals of a map of points, towards the viewer."""
    along, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    n = np.cross(along, down)
    n /= np.linalg.norm(n, axis=-1, keepdims=True) + 1e-9
    return np.where((n * points).sum(-1, keepdims=True) > 0, -n, n)


def tissue(rng, noise, points):
    """Colour of a wall, BGR 0 to 1, with vessels and blotches."""
    red = rng.uniform(0.55, 0.95)
    base = np.array([red * rng.uniform(0.2, 0.65), red * rng.uniform(0.3, 0.7), red])
    # Fat and mucus are yellow, blood is dark red.
    blotch = np.clip(0.5 + rng.uniform(0.5, 2) * noise(points * rng.uniform(0.8, 3)), 0, 1)[..., None] * rng.uniform(0, 0.8)
    other = base * rng.uniform(0.35, 1.3, 3)
    colour = base * (1 - blotch) + other * blotch
    warped = points * rng.uniform(1.5, 4) + 0.5 * np.stack([noise(points * 3 + k) for k in (0, 9, 17)], -1)
    vessel = np.exp(-((noise(warped) / rng.uniform(0.03, 0.1)) ** 2))[..., None] * rng.uniform(0, 0.7)
    colour = colour * (1 - vessel) + base * np.array([0.35, 0.3, 0.75]) * vessel
    grain = 1 + rng.uniform(0, 0.25) * noise(points * rng.uniform(10, 30))[..., None]
    return np.clip(colour * grain, 0, 1)


def frame(seed, width, height):
    """A picture, BGR u8: the same for the same seed and size."""
    rng = np.random.default_rng(seed)
    cavity = Cavity(rng)
    w, h = width // 2, height // 2
    focal = rng.uniform(0.45, 1.3) * w / 2
    y, x = np.mgrid[:h, :w].astype(np.float32)
    rays = np.stack([(x - w / 2) / focal, (y - h / 2) / focal, np.ones_like(x)], -1)
    turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ turn.T.astype(np.float32)
    origin = np.array([*rng.uniform(-0.3, 0.3, 2), 0.0]) * [1, cavity.flat, 1]
    points, far = march(cavity, rays, origin)
    bump = rng.uniform(0, 0.03) * cavity.noise(points * rng.uniform(8, 20))
    n = normals(points - origin + bump[..., None] * rays)
    facing = np.clip(-(n * rays).sum(-1), 0, 1)
    light = facing ** rng.uniform(0.6, 1.5) / (0.15 + far**2) * rng.uniform(0.3, 1.1)
    picture = tissue(rng, cavity.noise, points) * light[..., None]
    shine = np.where(facing > 0, facing, 0) ** rng.uniform(20, 150) * rng.uniform(0, 1.5) / (0.4 + far**2)
    picture = picture / (1 + rng.uniform(0.1, 0.8) * picture) + shine[..., None]
    haze = rng.choice([0, 0, 0, rng.uniform(0, 0.35)])
    picture = picture * (1 - haze) + haze * 0.5
    picture = cv2.resize(np.clip(picture, 0, 1) ** rng.uniform(0.45, 1.0), (width, height), interpolation=cv2.INTER_CUBIC)
    picture = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.3, 1.6))
    picture += rng.normal(0, rng.uniform(0.002, 0.02), picture.shape)
    if rng.random() < 0.6:
        # The round field of a scope, whole or cut by the picture's border.
        radius = rng.uniform(0.42, 0.75) * height
        at = np.array([width, height]) / 2 + rng.uniform(-0.05, 0.05, 2) * height
        yy, xx = np.mgrid[:height, :width]
        lit = np.clip(radius - np.hypot(xx - at[0], yy - at[1]), 0, 2) / 2
        picture = picture * lit[..., None] + 0.02 * rng.random()
    picture = (np.clip(picture, 0, 1) * 255).astype(np.uint8)
    code = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 96))])[1]
    return cv2.imdecode(code, cv2.IMREAD_COLOR)
