"""How long tests wait for what should end by itself."""

SECONDS = 600
"""Only a hang takes so long, on a slow and busy machine too; most need a fraction of one."""
