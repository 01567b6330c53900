"""Still frames of a video file, evenly spaced, through the ffmpeg that `instok3d[video]` brings."""

import subprocess
from pathlib import Path

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi"})


def extract_frames(path: Path, folder: Path, *, count: int = 48) -> list[Path]:
    """Write up to `count` evenly spaced frames of a video into a folder, upright, as JPEG.

    The rotation that phones write into the file is applied.

    Returns:
        The files in the order of time.

    Raises:
        ValueError: The video plugin is absent, or the file is no video or has no frame.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ValueError(
            f"{path} is a video, which needs a plugin: pip install 'instok3d[video]'"
        ) from error
    # "file:" keeps ffmpeg from reading a name as the address of something else.
    source = f"file:{path.resolve()}"
    try:
        there, duration_s = imageio_ffmpeg.count_frames_and_secs(source)
    except RuntimeError as error:
        raise ValueError(
            f"{path} is not a video that ffmpeg can read; copy it again or convert it to mp4"
        ) from error
    if not duration_s or not duration_s > 0:
        raise ValueError(f"{path} lasts {duration_s} s and has no frame to take")
    count = max(1, min(count, there or count))  # ffmpeg would repeat the frames of a short film
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-v", "error", "-i", source]
    command += ["-vf", f"fps={count}/{duration_s:.6f}:round=near", "-frames:v", str(count)]
    command += ["-q:v", "2", str(folder / "frame_%04d.jpg")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    frames = sorted(folder.glob("frame_*.jpg"))
    if result.returncode != 0 or not frames:
        reason = (result.stderr.strip().splitlines() or ["no frame came out"])[-1]
        raise ValueError(f"{path} could not be decoded ({reason}); convert it to mp4")
    return frames
