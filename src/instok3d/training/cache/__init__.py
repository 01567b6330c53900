"""Features of a frozen backbone, computed once and read in training."""
