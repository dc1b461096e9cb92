"""Meshes, convex hulls, contact points of collision shapes, and distances between shapes."""
