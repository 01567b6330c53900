"""Photos of the user: files, decoding, videos, cameras and depth that come with them."""
