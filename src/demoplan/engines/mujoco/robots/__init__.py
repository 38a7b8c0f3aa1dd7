"""Robots in physics scenes: how each is built and driven, and the motions that any of them can make.

``robot`` says what a robot must offer: bodies, and arms that find configurations for poses of a grasp.
``gripper`` is the light one, ``tiago`` that of the study, ``fingers`` what both close on things. ``paths``
lead over and around what stands on the table, ``checking`` tries them out before they are gone. ``motions``
are the skills, ``arm_control`` carries one out step by step, ``contacts`` watches what is touched.
"""
