"""Ways of 22 simulated vehicles: velocity (n, 3), m/s, NED, and attitude (n,) at times t (n,), s, drawn by `rng`."""

import numpy as np
from scipy.spatial.transform import Rotation
from vehicle_simulation import RATE, ahead, levels, smooth


def angles(yaw, pitch, roll):
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))


def waves(rng, t, sigma, slowest_s=8.0, fastest_s=3.0):
    """A sum of sines (n,), of this RMS."""
    rate, phase = 2.0 * np.pi / rng.uniform(fastest_s, slowest_s, 5), rng.uniform(0.0, 6.3, 5)
    return sigma * np.sqrt(0.4) * np.sin(np.outer(t, rate) + phase).sum(axis=1)


def plane(rng, t):
    """Straight, in turns with the bank that they need, climbing and descending; it starts on the ground."""
    go = np.clip((t - 8.0) / 12.0, 0.0, 1.0)
    speed = smooth(go * levels(rng, t, 14.0, 26.0, 20.0), 3.0)
    turns = levels(rng, t, -0.35, 0.35, 9.0) * (levels(rng, t, 0.0, 1.0, 14.0) > 0.4)
    rate = smooth(turns * (go >= 1.0), 1.5)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    pitch = smooth(levels(rng, t, -0.1, 0.15, 12.0) * (go >= 1.0), 2.0) + 0.01 * go * waves(rng, t, 1.0)
    roll = np.arctan(speed * rate / 9.8) + 0.02 * go * waves(rng, t, 1.0)
    return ahead(speed, yaw, pitch), angles(yaw + 0.01 * go * waves(rng, t, 1.0), pitch, roll)


def multicopter(rng, t):
    """It hovers in gusts for long, flies in any direction between, with the tilt that this needs, and turns."""
    aloft = np.clip((t - 8.0) / 3.0, 0.0, 1.0)
    flies = levels(rng, t, 0.0, 1.0, 18.0) > rng.uniform(0.2, 0.6)
    v = np.column_stack([smooth(smooth(levels(rng, t, -s, s, 6.0) * flies * aloft, 1.0), 1.0) for s in (6.0, 6.0, 1.5)])
    v += 0.15 * aloft[:, None] * np.column_stack([waves(rng, t, 1.0, 12.0, 3.0) for _ in range(3)])
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(smooth(levels(rng, t, -0.6, 0.6, 5.0) * flies * aloft, 1.0)) / RATE
    north, east, _ = np.gradient(v, t, axis=0).T
    along, right = north * np.cos(yaw) + east * np.sin(yaw), -north * np.sin(yaw) + east * np.cos(yaw)
    gusts = 0.02 * aloft[:, None] * np.column_stack([waves(rng, t, 1.0, 2.0, 0.5) for _ in range(2)])
    return v, angles(yaw, gusts[:, 0] - np.arctan(along / 9.8), gusts[:, 1] + np.arctan(right / 9.8))


def car(rng, t, slowest, fastest, every_s, stops, turn, turn_s):
    speed = levels(rng, t, slowest, fastest, every_s)
    speed[levels(rng, t, 0.0, 1.0, 11.0) < stops] = 0.0
    speed[t < 8.0] = 0.0
    speed = smooth(speed, 0.15 * fastest)
    turns = levels(rng, t, -turn, turn, turn_s) * (levels(rng, t, 0.0, 1.0, 1.2 * turn_s) > 0.4)
    rate = smooth(turns, 0.3 * turn_s) * np.clip(speed / 5.0, 0.0, 1.0)
    yaw, pitch = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE, 0.01 * np.gradient(speed, t)
    pitch += 0.002 * np.minimum(speed, 10.0) * waves(rng, t, 0.3, 3.0, 0.7)
    return ahead(speed, yaw, pitch), angles(yaw, pitch, 0.005 * speed * rate)


def city(rng, t):
    return car(rng, t, 2.0, 14.0, 9.0, 0.2, 0.35, 5.0)


def motorway(rng, t):
    return car(rng, t, 20.0, 34.0, 14.0, 0.0, 0.03, 12.0)


def boat(rng, t):
    """In a current, in waves that move, roll, nod and yaw it."""
    height = rng.uniform(0.2, 1.5)
    speed = smooth(levels(rng, t, 1.5, 7.0, 20.0), 5.0) * np.clip((t - 5.0) / 8.0, 0.0, 1.0)
    course = rng.uniform(-3.0, 3.0) + np.cumsum(smooth(levels(rng, t, -0.12, 0.12, 11.0), 3.0)) / RATE
    yaw = course + 0.04 * height * waves(rng, t, 1.0)
    v = ahead(speed, yaw) + np.append(rng.uniform(-0.6, 0.6, 2), 0.0)
    v += 0.25 * height * np.column_stack([waves(rng, t, 1.0) for _ in range(3)])
    return v, angles(yaw, 0.04 * height * waves(rng, t, 1.0), 0.07 * height * waves(rng, t, 1.0))


def walker(rng, t):
    """Two steps a second, which bob and sway; it stands now and then."""
    pace = 2.0 * np.pi * np.cumsum(0.9 + 0.05 * waves(rng, t, 1.0)) / RATE
    go = smooth(((t > 5.0) & (levels(rng, t, 0.0, 1.0, 14.0) > 0.15)).astype(float), 1.0)
    speed = smooth(levels(rng, t, 0.9, 1.7, 8.0), 1.5) * go * (1.0 + 0.15 * np.sin(2.0 * pace))
    turns = levels(rng, t, -0.6, 0.6, 5.0) * (levels(rng, t, 0.0, 1.0, 6.0) > 0.4)
    course = rng.uniform(-3.0, 3.0) + np.cumsum(smooth(turns, 1.0) * go) / RATE
    v = ahead(speed, course)
    v += (0.12 * go * np.sin(pace))[:, None] * np.column_stack([-np.sin(course), np.cos(course), 0.0 * t])
    v[:, 2] += 0.25 * go * np.sin(2.0 * pace)
    yaw = course + rng.uniform(-3.0, 3.0) + 0.05 * go * np.sin(pace)
    return v, angles(yaw, 0.3 + 0.05 * go * np.sin(2.0 * pace), 0.04 * go * np.sin(pace) + 0.05 * waves(rng, t, 1.0))


def motorcycle(rng, t):
    """It leans into its turns."""
    speed = levels(rng, t, 3.0, 25.0, 9.0)
    speed[(levels(rng, t, 0.0, 1.0, 11.0) < 0.15) | (t < 8.0)] = 0.0
    speed = smooth(speed, 3.0)
    turns = smooth(levels(rng, t, -1.0, 1.0, 4.0) * (levels(rng, t, 0.0, 1.0, 5.0) > 0.4), 1.2)
    rate = turns * np.minimum(7.0 / np.maximum(speed, 3.0), 0.6) * np.clip(speed / 3.0, 0.0, 1.0)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    pitch = 0.006 * np.gradient(speed, t) + 0.002 * np.minimum(speed, 10.0) * waves(rng, t, 0.3, 3.0, 0.7)
    roll = np.arctan(speed * rate / 9.8) + 0.01 * np.clip(speed, 0.0, 1.0) * waves(rng, t, 1.0)
    return ahead(speed, yaw, pitch), angles(yaw, pitch, roll)


def robot(rng, t):
    """Slow, also backward; it turns on the spot."""
    phase, speed, turns = levels(rng, t, 0.0, 1.0, 4.0), levels(rng, t, -0.5, 1.2, 4.0), levels(rng, t, -1.2, 1.2, 3.0)
    speed[(phase < 0.35) | (t < 6.0)] = 0.0
    turns[(phase < 0.1) | (t < 6.0)] = 0.0
    turns[(phase > 0.35) & (phase < 0.7)] *= 0.2
    speed, yaw = smooth(speed, 0.4), rng.uniform(-3.0, 3.0) + np.cumsum(smooth(turns, 0.3)) / RATE
    nods = 0.005 * np.minimum(np.abs(speed), 1.0)
    pitch, roll = nods * waves(rng, t, 1.0, 2.0, 0.5), nods * waves(rng, t, 1.0, 2.0, 0.5)
    return ahead(speed, yaw, pitch), angles(yaw, pitch, roll)


def tram(rng, t):
    speed = levels(rng, t, 0.0, 15.0, 15.0)
    speed[(levels(rng, t, 0.0, 1.0, 18.0) < 0.25) | (t < 8.0)] = 0.0
    speed = smooth(speed, 6.0)
    curve = smooth(levels(rng, t, -1.0 / 60.0, 1.0 / 60.0, 10.0) * (levels(rng, t, 0.0, 1.0, 12.0) > 0.5), 3.0)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(speed * curve) / RATE
    return ahead(speed, yaw), angles(yaw, 0.0 * t, 0.003 * np.minimum(speed, 5.0) * waves(rng, t, 0.3, 2.0, 0.5))


def sailboat(rng, t):
    """It heels and drifts to the lee side, which changes when it tacks."""
    tack = smooth(np.where(levels(rng, t, -1.0, 1.0, 40.0) > 0.0, 1.0, -1.0), 5.0)
    heel, leeway, height = np.radians(rng.uniform(8.0, 28.0)), np.radians(rng.uniform(2.0, 7.0)), rng.uniform(0.1, 0.8)
    speed = smooth(levels(rng, t, 2.0, 4.5, 20.0), 5.0) * np.clip((t - 3.0) / 8.0, 0.0, 1.0)
    turns = np.cumsum(smooth(levels(rng, t, -0.02, 0.02, 9.0), 3.0)) / RATE
    yaw = rng.uniform(-3.0, 3.0) + np.radians(45.0) * tack + turns
    v = ahead(speed, yaw + leeway * tack) + np.append(rng.uniform(-0.5, 0.5, 2), 0.0)
    v += 0.25 * height * np.column_stack([waves(rng, t, 1.0) for _ in range(3)])
    yaw, pitch = yaw + 0.03 * height * waves(rng, t, 1.0), 0.04 * height * waves(rng, t, 1.0)
    return v, angles(yaw, pitch, heel * tack + 0.05 * height * waves(rng, t, 1.0))


def crane(rng, t):
    """The sensor is on a cabin that turns about an axis some metres beside it; now and then the crane drives."""
    rate = smooth(levels(rng, t, -0.6, 0.6, 6.0) * (levels(rng, t, 0.0, 1.0, 8.0) > 0.3) * (t > 6.0), 1.0)
    yaw, radius = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE, rng.uniform(1.0, 3.0)
    v = (radius * rate)[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw), 0.0 * t])
    drives = smooth(levels(rng, t, -0.8, 0.8, 10.0) * (levels(rng, t, 0.0, 1.0, 15.0) > 0.7) * (t > 6.0), 1.0)
    v += ahead(drives, np.full(len(t), rng.uniform(-3.0, 3.0)))
    pitch, roll = (0.004 * (t > 6.0) * waves(rng, t, 1.0, 2.0, 0.5) for _ in range(2))
    return v, angles(yaw, pitch, roll)


def helicopter(rng, t):
    """Fast, with a sideslip, and in hover."""
    aloft = np.clip((t - 8.0) / 5.0, 0.0, 1.0)
    speed = smooth(levels(rng, t, 0.0, 35.0, 15.0) * aloft, 5.0)
    rate = smooth(levels(rng, t, -0.3, 0.3, 9.0) * (levels(rng, t, 0.0, 1.0, 12.0) > 0.4) * aloft, 2.0)
    course = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    yaw = course + smooth(levels(rng, t, -0.5, 0.5, 12.0), 4.0)
    v = ahead(speed, course)
    v[:, 2] -= smooth(levels(rng, t, -3.0, 3.0, 10.0) * aloft, 3.0)
    pitch = -0.002 * speed - np.arctan(np.gradient(speed, t) / 9.8) + 0.01 * aloft * waves(rng, t, 1.0)
    return v, angles(yaw, pitch, np.arctan(speed * rate / 9.8) + 0.01 * aloft * waves(rng, t, 1.0))


def glider(rng, t):
    """It circles in thermals for a minute and more, in a wind, and glides straight between."""
    go = np.clip((t - 8.0) / 12.0, 0.0, 1.0)
    speed = smooth(go * levels(rng, t, 22.0, 32.0, 20.0), 3.0)
    circles = (levels(rng, t, 0.0, 1.0, 45.0) > 0.35) * np.where(levels(rng, t, -1.0, 1.0, 60.0) > 0.0, 1.0, -1.0)
    rate = smooth(circles * rng.uniform(0.25, 0.4) * (go >= 1.0), 2.0)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    pitch = 0.02 * go * waves(rng, t, 1.0)
    v = ahead(speed, yaw, pitch) + go[:, None] * np.append(rng.uniform(-7.0, 7.0, 2), 0.0)
    v[:, 2] -= smooth(np.where(circles != 0.0, 2.0, -1.0) * go, 4.0)
    yaw = yaw + 0.02 * go * waves(rng, t, 1.0)
    return v, angles(yaw, pitch, np.arctan(speed * rate / 9.8) + 0.03 * go * waves(rng, t, 1.0))


def aerobatic_rates(rng, n):
    """Roll and pitch rates (n,), rad/s, of loops, rolls and steep turns, with pauses between."""
    roll, pitch = np.zeros(n), np.zeros(n)
    at = int(30 * RATE)
    while at < n - int(15 * RATE):
        figure = rng.integers(0, 4)
        if figure == 0:
            duration = rng.uniform(5.0, 8.0)
            length = int(duration * RATE)
            pitch[at : at + length] = 2.0 * np.pi / duration
        elif figure == 1:
            duration = rng.uniform(1.5, 4.0)
            length = int(duration * RATE)
            roll[at : at + length] = 2.0 * np.pi / duration * rng.choice([-1, 1])
        else:
            bank = rng.uniform(0.6, 1.2) * rng.choice([-1, 1])
            leans, turns = int(RATE), int(rng.uniform(3.0, 8.0) * RATE)
            roll[at : at + leans] = bank
            pitch[at + leans : at + leans + turns] = 9.8 * np.tan(abs(bank)) / 30.0 * np.sin(abs(bank))
            roll[at + leans + turns : at + 2 * leans + turns] = -bank
            length = 2 * leans + turns
        at += length + int(rng.uniform(2.0, 8.0) * RATE)
    return smooth(roll, 0.3), smooth(pitch, 0.5)


def aerobatic(rng, t):
    """Loops, rolls and steep turns of an aeroplane that flies where it points, and levels itself between them."""
    go = np.clip((t - 8.0) / 12.0, 0.0, 1.0)
    roll_rate, pitch_rate = aerobatic_rates(rng, len(t))
    x, y, z, w = Rotation.from_euler("ZYX", [rng.uniform(-3.0, 3.0), 0.0, 0.0]).as_quat()
    quaternions = np.empty((len(t), 4))
    for i in range(len(t)):
        quaternions[i] = x, y, z, w
        p, q = roll_rate[i], pitch_rate[i]
        if p * p + q * q < 1e-4:
            p -= 0.8 * np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
            q += 0.8 * np.arcsin(np.clip(2.0 * (x * z - w * y), -1.0, 1.0))
        a, b = 0.5 * p / RATE, 0.5 * q / RATE
        x, y, z, w = x + w * a - z * b, y + w * b + z * a, z + x * b - y * a, w - x * a - y * b
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
    attitude, speed = Rotation.from_quat(quaternions), smooth(go * levels(rng, t, 25.0, 38.0, 15.0), 3.0)
    return attitude.apply(np.column_stack([speed, 0.0 * t, 0.0 * t])), attitude


def rally(rng, t):
    """A car that slides by up to 25 degrees in curves, on a rough road."""
    speed = levels(rng, t, 5.0, 28.0, 6.0)
    speed[t < 8.0] = 0.0
    speed = smooth(speed, 2.5)
    turns = smooth(levels(rng, t, -0.6, 0.6, 3.0) * (levels(rng, t, 0.0, 1.0, 4.0) > 0.3), 0.8)
    rate = turns * np.minimum(1.0, 8.0 / np.maximum(speed, 1.0)) * np.clip(speed / 5.0, 0.0, 1.0)
    course = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    slides = np.clip(smooth(0.06 * speed * rate, 1.0) * np.clip(speed / 8.0, 0.0, 1.0), -0.45, 0.45)
    v = ahead(speed, course, 0.06 * np.clip(speed / 5.0, 0.0, 1.0) * waves(rng, t, 1.0))
    rough = np.minimum(speed, 10.0) / 3.0
    v[:, 2] += 0.1 * rough * waves(rng, t, 1.0, 1.5, 0.4)
    pitch = 0.01 * np.gradient(speed, t) + 0.01 * rough * waves(rng, t, 1.0, 2.0, 0.5)
    return v, angles(course + slides, pitch, -0.004 * speed * rate + 0.01 * rough * waves(rng, t, 1.0, 2.0, 0.5))


def tractor(rng, t):
    """To and fro across a slope, down which it slips."""
    speed = smooth(levels(rng, t, 1.0, 4.0, 20.0) * (t > 8.0), 3.0)
    side = np.where((t // 35.0) % 2 > 0, 1.0, -1.0)
    rate = smooth(np.where(t % 35.0 > 28.0, np.pi / 7.0 * side, 0.0) * (t > 8.0), 1.0) * np.clip(speed, 0.0, 1.0)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    steep, uphill = rng.uniform(0.05, 0.25), rng.uniform(-3.0, 3.0)
    roll, pitch = -steep * np.sin(uphill - yaw), steep * np.cos(uphill - yaw)
    nods = 0.01 * np.minimum(speed, 2.0)
    v = ahead(speed, yaw + 0.25 * roll, pitch)
    return v, angles(yaw, pitch + nods * waves(rng, t, 1.0, 2.0, 0.5), roll + nods * waves(rng, t, 1.0, 2.0, 0.5))


def bicycle(rng, t):
    """It leans into its turns, and sways as its rider pedals."""
    speed = levels(rng, t, 2.0, 10.0, 8.0)
    speed[(levels(rng, t, 0.0, 1.0, 12.0) < 0.15) | (t < 8.0)] = 0.0
    speed = smooth(speed, 2.0)
    turns = smooth(levels(rng, t, -0.7, 0.7, 4.0) * (levels(rng, t, 0.0, 1.0, 5.0) > 0.5), 1.0)
    rate = turns * np.clip(speed / 3.0, 0.0, 1.0) * np.minimum(1.0, 6.0 / np.maximum(speed, 1.0))
    pedals = 2.0 * np.pi * np.cumsum(1.2 + 0.1 * waves(rng, t, 1.0)) / RATE
    sways = np.clip(speed / 2.0, 0.0, 1.0) * rng.uniform(0.01, 0.06) * np.sin(pedals)
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    speed = speed * (1.0 + 0.02 * np.sin(2.0 * pedals))
    pitch = 0.01 * np.clip(speed, 0.0, 1.0) * waves(rng, t, 1.0, 2.0, 0.5)
    return ahead(speed, yaw), angles(yaw + 0.5 * sways, pitch, np.arctan(speed * rate / 9.8) + sways)


def forklift(rng, t):
    """It turns about its front axle, ahead of the sensor, and goes backward half of the time."""
    speed = levels(rng, t, -3.0, 3.5, 5.0)
    speed[(levels(rng, t, 0.0, 1.0, 6.0) < 0.25) | (t < 6.0)] = 0.0
    speed = smooth(speed, 1.0)
    turns = levels(rng, t, -1.0, 1.0, 3.0) * (levels(rng, t, 0.0, 1.0, 3.0) > 0.4) * (t > 6.0)
    rate = smooth(turns, 0.5) * np.clip(np.abs(speed) / 0.5, 0.0, 1.0)
    yaw, behind = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE, rng.uniform(0.5, 1.5)
    v = ahead(speed, yaw) - (behind * rate)[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw), 0.0 * t])
    nods = 0.004 * np.minimum(np.abs(speed), 1.0)
    pitch = nods * waves(rng, t, 1.0, 2.0, 0.5) + 0.01 * np.gradient(speed, t)
    return v, angles(yaw, pitch, nods * waves(rng, t, 1.0, 2.0, 0.5))


def racing_drone(rng, t):
    """Tilted by up to 60 degrees, with quick turns."""
    aloft = np.clip((t - 8.0) / 2.0, 0.0, 1.0)
    v = np.column_stack([smooth(smooth(levels(rng, t, -s, s, 3.0) * aloft, 0.7), 0.7) for s in (15.0, 15.0, 3.0)])
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(smooth(levels(rng, t, -2.5, 2.5, 2.5) * aloft, 0.4)) / RATE
    down = np.array([0.0, 0.0, 9.8]) - np.gradient(v, t, axis=0)
    down /= np.linalg.norm(down, axis=1)[:, None]
    right = np.cross(down, np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * t]))
    right /= np.linalg.norm(right, axis=1)[:, None]
    attitude = Rotation.from_matrix(np.stack([np.cross(right, down), right, down], axis=2))
    gusts = 0.02 * aloft[:, None] * np.column_stack([waves(rng, t, 1.0, 1.0, 0.2) for _ in range(3)])
    return v, attitude * Rotation.from_euler("ZYX", gusts)


def ship(rng, t):
    """Slow to turn, in a swell and a current."""
    speed = smooth(levels(rng, t, 4.0, 9.0, 60.0), 20.0) * np.clip((t - 5.0) / 40.0, 0.0, 1.0)
    rolls = rng.uniform(0.03, 0.15)
    course = rng.uniform(-3.0, 3.0) + np.cumsum(smooth(levels(rng, t, -0.02, 0.02, 40.0), 10.0)) / RATE
    v = ahead(speed, course + 0.06 * waves(rng, t, 1.0, 60.0, 30.0)) + np.append(rng.uniform(-0.8, 0.8, 2), 0.0)
    v += 0.5 * np.column_stack([waves(rng, t, 1.0, 14.0, 7.0) for _ in range(3)]) * np.array([0.4, 0.4, 1.0])
    yaw, pitch = course + 0.02 * waves(rng, t, 1.0, 14.0, 7.0), 0.02 * waves(rng, t, 1.0, 12.0, 6.0)
    return v, angles(yaw, pitch, rolls * waves(rng, t, 1.0, 14.0, 9.0))


def balloon(rng, t):
    """It drifts with the wind, turns slowly and sways."""
    aloft = np.clip((t - 10.0) / 20.0, 0.0, 1.0)
    wind = [smooth(levels(rng, t, -1.0, 1.0, 25.0), 10.0) * 1.5 + rng.uniform(-5.0, 5.0) for _ in range(2)]
    v = np.column_stack([*wind, -smooth(levels(rng, t, -2.0, 3.0, 20.0), 6.0)]) * aloft[:, None]
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(smooth(levels(rng, t, -0.15, 0.15, 20.0) * aloft, 6.0)) / RATE
    pitch, roll = (0.02 * aloft * waves(rng, t, 1.0, 6.0, 3.0) for _ in range(2))
    return v, angles(yaw, pitch, roll)


def lorry(rng, t):
    """Over long hills, slow to accelerate, with a sprung cabin."""
    speed = smooth(levels(rng, t, 8.0, 24.0, 20.0) * (t > 8.0), 8.0)
    turns = smooth(levels(rng, t, -0.1, 0.1, 8.0) * (levels(rng, t, 0.0, 1.0, 9.0) > 0.5), 3.0)
    go = np.clip(speed / 5.0, 0.0, 1.0)
    rate = turns * go
    yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rate) / RATE
    hill, nods = smooth(levels(rng, t, -0.07, 0.07, 15.0), 6.0) * go, 0.01 * go
    v, yaw = ahead(speed, yaw, hill), yaw + 0.3 * nods * waves(rng, t, 1.0, 2.0, 0.7)
    pitch = hill + 0.03 * np.gradient(speed, t) + nods * waves(rng, t, 1.0, 2.0, 0.7)
    return v, angles(yaw, pitch, 0.01 * speed * rate + nods * waves(rng, t, 1.0, 2.0, 0.7))


VEHICLES = {  # way; vibration, m/s/sqrt(s) and deg/sqrt(s): least and greatest
    "plane": (plane, (0.01, 0.2), (0.005, 0.15)),
    "multicopter": (multicopter, (0.03, 0.4), (0.01, 0.3)),
    "city": (city, (0.005, 0.1), (0.002, 0.05)),
    "motorway": (motorway, (0.01, 0.15), (0.002, 0.05)),
    "boat": (boat, (0.005, 0.1), (0.002, 0.05)),
    "walker": (walker, (0.01, 0.1), (0.01, 0.1)),
    "motorcycle": (motorcycle, (0.01, 0.15), (0.005, 0.05)),
    "robot": (robot, (0.005, 0.1), (0.005, 0.05)),
    "tram": (tram, (0.003, 0.05), (0.001, 0.02)),
    "sailboat": (sailboat, (0.003, 0.05), (0.002, 0.03)),
    "crane": (crane, (0.005, 0.1), (0.002, 0.05)),
    "helicopter": (helicopter, (0.05, 0.4), (0.02, 0.2)),
    "glider": (glider, (0.01, 0.15), (0.005, 0.1)),
    "aerobatic": (aerobatic, (0.03, 0.3), (0.01, 0.15)),
    "rally": (rally, (0.05, 0.3), (0.01, 0.15)),
    "tractor": (tractor, (0.02, 0.15), (0.005, 0.08)),
    "bicycle": (bicycle, (0.02, 0.15), (0.005, 0.1)),
    "forklift": (forklift, (0.01, 0.15), (0.005, 0.05)),
    "racing drone": (racing_drone, (0.05, 0.4), (0.02, 0.3)),
    "ship": (ship, (0.003, 0.03), (0.001, 0.02)),
    "balloon": (balloon, (0.002, 0.02), (0.001, 0.02)),
    "lorry": (lorry, (0.02, 0.2), (0.005, 0.08)),
}
