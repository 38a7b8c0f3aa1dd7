"""Robots in physics scenes: how each is built and driven, and the motions that any of them can make.

``robot`` says what a robot must offer: bodies, and arms that find configurations for poses of their grasp.
``gripper`` is the light one, ``tiago`` the one of the study. ``fingers`` close on things, ``paths`` go over and
around what stands on the table, ``motions`` are the skills, ``arm_control`` carries one out tick by tick.
"""
