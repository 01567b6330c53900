"""Methods of others, implemented here from their papers, behind `evaluation.methods.Method`."""
