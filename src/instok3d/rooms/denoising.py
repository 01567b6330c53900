"""The seam to a denoiser: Open Image Denoise on one thread, where it is installed."""

import warnings

import numpy as np
from jaxtyping import Float

Image = Float[np.ndarray, "height width 3"]


class Denoiser:
    """Open Image Denoise, quality Fast, on one CPU thread: the same bytes on any machine load."""

    def __init__(self):
        """Raises ImportError where mitsuba-oidn is not installed."""
        import mitsuba_oidn

        device = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CPU)
        device.set_int("numThreads", 1)
        device.set_bool("setAffinity", False)
        device.commit()
        self._oidn, self._device = mitsuba_oidn, device

    def __call__(self, radiance: Image, albedo: Image, normals: Image) -> Image:
        """The radiance without its noise, guided by noise-free albedo and normals."""
        cleaned = self._oidn.denoise(
            radiance, albedo=albedo, normal=normals, hdr=True, clean_aux=True,
            quality=self._oidn.Quality.Fast, device=self._device,
        )  # fmt: skip
        return np.asarray(cleaned)


def find_denoiser() -> Denoiser | None:
    """The denoiser, or None with a warning: the renderer then takes more samples."""
    try:
        return Denoiser()
    except ImportError:
        warnings.warn(
            "mitsuba-oidn is not installed: rooms render four times slower and noisier; "
            "install it with `pip install 'instok3d[rooms]'`",
            stacklevel=2,
        )
        return None
