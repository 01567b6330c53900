"""Two captures of one room: aligned on what they share, and what changed between them."""
