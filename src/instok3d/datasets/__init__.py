"""Real data sets: one prepared format for all, the readers of their originals, made ids."""
