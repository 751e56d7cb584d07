"""Files from strangers: each is refused, or read within limits of time and memory."""
