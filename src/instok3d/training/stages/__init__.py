"""The stages of training: what each one learns, from which samples, by which losses."""
