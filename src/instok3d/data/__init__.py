"""Training samples: what a data set offers, which views go together, batches."""
