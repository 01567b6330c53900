"""Cameras of photos by structure from motion (optional: `pip install 'instok3d[sfm]'`)."""
