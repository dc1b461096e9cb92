"""MJCF, MuJoCo's format (https://mujoco.readthedocs.io/en/stable/XMLreference.html): read through MuJoCo, and written.

MuJoCo's own compiler resolves defaults, angles, includes and inertias of geoms; a Model is made of what it compiles.
The coordinates of the Model are MuJoCo's qpos and qvel, in their order.  The last bits of its numbers are MuJoCo's and
its libm's, which may differ between processors.
"""
