"""Libraries of scenes: every object of every scene, found by text or image."""
