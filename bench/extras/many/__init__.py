"""Workers for much work: the processes of this computer, and the workers of a Dask scheduler."""
