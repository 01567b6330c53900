"""Still frames of a video file, evenly spaced, through the ffmpeg that `instok3d[video]` brings."""

import re
import subprocess
from pathlib import Path

VIDEO_SUFFIXES = frozenset(
    {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".3gp", ".3g2"}
    | {".mpg", ".mpeg", ".m2v", ".vob", ".wmv", ".asf", ".flv", ".ogv", ".mxf", ".dv"}
)
"""By which a file in a folder is pointed out as a video; what is read is decided by its bytes."""
CONTAINERS = (
    "mov,matroska,avi,mpegts,mpeg,mpegvideo,asf,asf_o,flv,live_flv,kux,ogg,mxf,mxg,gxf,dv,wtv,"
    "nut,nuv,rm,swf,ivf,obu,av1,h261,h263,h264,hevc,vvc,evc,m4v,vc1,vc1test,dirac,cavsvideo,avs2,"
    "avs3,dnxhd,yuv4mpegpipe,pva,ty,lvf,r3d,vivo,smjpeg,mjpeg,mjpeg_2000,flic,roq,film_cpk,smk,"
    "bink,thp,xmv,4xm,3dostr,cdxl,ipmovie,mtv,amv"
)
"""ffmpeg's formats that hold moving pictures. The others stay off: lists that lead to further
files (hls, concat, dash), and text that ffmpeg would draw (tty, subtitles)."""


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
        known = path.suffix.lower() in VIDEO_SUFFIXES
        what = "is a video" if known else "is no picture in a known format but perhaps a video"
        raise ValueError(
            f"{path} {what}, which needs a plugin: pip install 'instok3d[video]'"
        ) from error
    program = imageio_ffmpeg.get_ffmpeg_exe()
    there = _count_frames(program, path)
    count = min(count, there)
    wanted = [round(k * (there - 1) / max(count - 1, 1)) for k in range(count)]
    chosen = "+".join(rf"eq(n\,{number})" for number in wanted)
    # New times in even steps, or ffmpeg would repeat and drop frames to reach a constant rate.
    filters = f"select={chosen},settb=1/25,setpts=N,fps=25"
    words = ["-vf", filters, "-frames:v", str(count), "-q:v", "2", "frame_%04d.jpg"]
    result = _run(program, path, *words, folder=folder)
    frames = sorted(folder.glob("frame_*.jpg"))
    if result.returncode != 0 or not frames:
        reason = (result.stderr.strip().splitlines() or ["no frame came out"])[-1]
        raise ValueError(f"{path} could not be decoded ({reason}); convert it to mp4")
    return frames


def _count_frames(program: str, path: Path) -> int:
    result = _run(program, path, "-f", "null", "-")
    counts = re.findall(r"frame=\s*(\d+)", result.stderr)
    if result.returncode != 0 or not counts:
        with path.open("rb") as stream:
            head = stream.read(8)
        raise ValueError(
            f"{path} is not a video that ffmpeg can read, nor a picture in a known format (it "
            f"begins with {head!r}); copy it again, or convert it to mp4 or JPEG"
        )
    if int(counts[-1]) == 0:
        raise ValueError(f"{path} is a video without a frame; record it again")
    return int(counts[-1])


def _run(
    program: str, path: Path, *words: str, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    # "file:" keeps ffmpeg from reading a name as the address of something else.
    source = ["-format_whitelist", CONTAINERS, "-i", f"file:{path.absolute()}", "-map", "0:v:0"]
    return subprocess.run(
        [program, "-nostdin", "-hide_banner", "-y", *source, *words],
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
        cwd=folder,
    )
