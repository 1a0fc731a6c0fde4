"""Times of the kernels of servoscope beside those of its peers, in one run on the same data."""
