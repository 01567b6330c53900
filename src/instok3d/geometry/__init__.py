"""Mathematics of cameras, rotations and points; nothing here learns."""
