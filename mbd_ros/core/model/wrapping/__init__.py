"""Paths that wrap over cylinders, spheres, ellipsoids and tori."""
