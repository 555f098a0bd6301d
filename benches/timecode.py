#!/usr/bin/env python3
"""Decodes timecode that Debian's libltc generated (package libltc-dev or libltc11).

    python3 benches/timecode.py target/release/stagepose --check

Every rate, speeds from 0.5 to 1.5, forwards and backwards, with noise. A frame may be absent, never
wrong. With --check it fails if a frame is wrong, if more than the first two of a run are absent at a
noise of 20 % of the signal or less, or if a frame begins elsewhere by more than 1.5 samples.
"""

import array
import ctypes
import ctypes.util
import json
import os
import random
import struct
import subprocess
import sys
import tempfile

SAMPLE_RATE = 48_000
# libltc's television standards.
TV_525, TV_625, FILM = 0, 1, 3
# Name, frames per second, frames counted, drop frame, standard.
RATES = [
    ("23.976", 24_000 / 1001, 24, False, FILM),
    ("24", 24.0, 24, False, FILM),
    ("25", 25.0, 25, False, TV_625),
    ("29.97", 30_000 / 1001, 30, False, TV_525),
    ("29.97df", 30_000 / 1001, 30, True, TV_525),
    ("30", 30.0, 30, False, TV_525),
]
SPEEDS = [0.5, 0.75, 0.95, 1.0, 1.05, 1.25, 1.5]
# Standard deviation of the noise, as a fraction of the signal's peak.
NOISES = [0.0, 0.1, 0.2, 0.5, 1.0]
FRAMES = 120


class Timecode(ctypes.Structure):
    """libltc's SMPTETimecode."""

    _fields_ = [("timezone", ctypes.c_char * 6)] + [
        (name, ctypes.c_ubyte) for name in ("years", "months", "days", "hours", "mins", "secs", "frame")
    ]


def library():
    name = ctypes.util.find_library("ltc") or "libltc.so.11"
    ltc = ctypes.CDLL(name)
    ltc.ltc_encoder_create.restype = ctypes.c_void_p
    ltc.ltc_encoder_create.argtypes = [ctypes.c_double, ctypes.c_double, ctypes.c_int, ctypes.c_int]
    ltc.ltc_encoder_set_buffersize.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
    ltc.ltc_encoder_encode_byte.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_double]
    for name in ("ltc_encoder_set_timecode", "ltc_encoder_set_frame", "ltc_encoder_get_frame", "ltc_encoder_copy_buffer"):
        getattr(ltc, name).argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    ltc.ltc_encoder_free.argtypes = [ctypes.c_void_p]
    ltc.ltc_frame_set_parity.argtypes = [ctypes.c_void_p, ctypes.c_int]
    return ltc


def following(code, counted, drop):
    """The frame after hours, minutes, seconds, frames, by the rule of ST 12-1."""
    hours, minutes, seconds, frames = code
    frames += 1
    if frames == counted:
        frames, seconds = 0, seconds + 1
    if seconds == 60:
        seconds, minutes = 0, minutes + 1
        if minutes == 60:
            minutes, hours = 0, (hours + 1) % 24
        if drop and minutes % 10:
            frames = 2
    return hours, minutes, seconds, frames


def generate(ltc, rate, speed):
    """Returns samples from -1 to 1, and where each frame begins, samples, with its timecode."""
    _, fps, counted, drop, standard = rate
    codes = [(23, 59, 57, 20)]
    while len(codes) < FRAMES:
        codes.append(following(codes[-1], counted, drop))
    if drop:
        # Across a minute that leaves out two numbers.
        codes = [(9, 58, 57, 20)]
        while len(codes) < FRAMES:
            codes.append(following(codes[-1], counted, drop))
    order = codes if speed > 0 else codes[::-1]
    encoder = ltc.ltc_encoder_create(SAMPLE_RATE, fps, standard, 0)
    # Room for a frame at half speed.
    ltc.ltc_encoder_set_buffersize(encoder, SAMPLE_RATE, 5.0)
    samples, begins = [], []
    buffer = (ctypes.c_ubyte * SAMPLE_RATE)()
    frame = (ctypes.c_ubyte * 10)()
    for k, code in enumerate(order):
        hours, minutes, seconds, frames = code
        typed = Timecode(b"+0000", 26, 11, 30, hours, minutes, seconds, frames)
        ltc.ltc_encoder_set_timecode(encoder, ctypes.byref(typed))
        ltc.ltc_encoder_get_frame(encoder, frame)
        frame[1] = (frame[1] & ~4) | (4 if drop else 0)
        ltc.ltc_frame_set_parity(frame, standard)
        ltc.ltc_encoder_set_frame(encoder, frame)
        length = SAMPLE_RATE / fps / abs(speed)
        begins.append((k + (speed < 0)) * length)
        # To libltc, speed is how much longer a frame takes.
        for byte in range(10) if speed > 0 else range(9, -1, -1):
            if ltc.ltc_encoder_encode_byte(encoder, byte, 1.0 / speed):
                sys.exit("libltc refuses to encode")
        count = ltc.ltc_encoder_copy_buffer(encoder, buffer)
        samples.extend((value - 128) / 128 for value in buffer[:count])
    ltc.ltc_encoder_free(encoder)
    mark = ";" if drop else ":"
    words = ["%02d:%02d:%02d%s%02d" % (h, m, s, mark, f) for h, m, s, f in order]
    return samples, list(zip(words, begins))


def write_wav(file, samples):
    data = array.array("h", (max(-32768, min(32767, round(value * 32767))) for value in samples)).tobytes()
    head = struct.pack("<4sI4s4sIHHIIHH4sI", b"RIFF", 36 + len(data), b"WAVE", b"fmt ", 16, 1, 1, SAMPLE_RATE, 2 * SAMPLE_RATE, 2, 16, b"data", len(data))
    with open(file, "wb") as out:
        out.write(head + data)


def decode(program, folder, samples):
    """Returns where frames begin, samples, with their timecodes, and the rate as heard."""
    wav, csv, out = (os.path.join(folder, name) for name in ("ltc.wav", "frames.csv", "out.json"))
    write_wav(wav, samples)
    run = subprocess.run([program, "timecode", wav, "--frames", csv, "--json", out], capture_output=True, text=True)
    with open(csv) as file:
        rows = [line.strip().split(",") for line in file if not line.startswith("#")]
    with open(out) as file:
        heard = json.load(file)
    if run.returncode and rows:
        sys.exit(run.stderr)
    return [(code, float(seconds) * SAMPLE_RATE) for seconds, code, _ in rows], heard


def judge(found, truth):
    """Returns how many frames are wrong and absent, and the largest error of a frame's beginning."""
    at = {code: begin for code, begin in truth}
    wrong = sum(code not in at for code, _ in found)
    errors = [begin - at[code] for code, begin in found if code in at]
    # libltc's rounded edges cross the middle a constant time after their bit.
    middle = sorted(errors)[len(errors) // 2] if errors else 0.0
    return wrong, len(truth) - len(found) + wrong, max((abs(e - middle) for e in errors), default=0.0), middle


def main():
    program, check = sys.argv[1], "--check" in sys.argv
    ltc, faults, worst = library(), [], {}
    random.seed(1)
    with tempfile.TemporaryDirectory() as folder:
        for rate in RATES:
            for speed in [s * d for s in SPEEDS for d in (1, -1)]:
                clean, truth = generate(ltc, rate, speed)
                peak = max(abs(value) for value in clean)
                for noise in NOISES:
                    samples = [value + random.gauss(0.0, noise * peak) for value in clean] if noise else clean
                    found, heard = decode(program, folder, samples)
                    wrong, absent, error, late = judge(found, truth)
                    before = worst.get(noise, (0, 0, 0.0, 0.0))
                    worst[noise] = (before[0] + wrong, max(before[1], absent), max(before[2], error), max(before[3], abs(late)))
                    name = f"{rate[0]} x {speed}, noise {noise}"
                    if wrong:
                        faults.append(f"{name}: {wrong} frames are wrong")
                    if noise <= 0.2 and absent > 2:
                        faults.append(f"{name}: {absent} frames are absent")
                    if noise <= 0.2 and error > 1.5:
                        faults.append(f"{name}: a frame begins {error:.2f} samples off")
                    if noise == 0 and abs(speed) == 1 and heard["rate"] != rate[0]:
                        faults.append(f"{name}: heard as {heard['rate']}")
    signals = len(RATES) * 2 * len(SPEEDS)
    print(f"{signals} signals of {FRAMES} frames at each noise: {len(RATES)} rates, {len(SPEEDS)} speeds, both directions")
    for noise, (wrong, absent, error, late) in worst.items():
        print(f"noise {noise}: {wrong} wrong, at most {absent} absent, edges within {error:.2f} samples of {late:.2f}")
    print("\n".join(faults))
    if check and faults:
        sys.exit(1)


if __name__ == "__main__":
    main()
