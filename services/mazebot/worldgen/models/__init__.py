"""Models of SDF and URDF that can be put into a world."""
