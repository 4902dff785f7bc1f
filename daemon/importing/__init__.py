"""Data of other programs, turned into our files: poses of flange and target, and a UR arm's own kinematics.

Every reader states the units, the frames and the convention of rotation of what it reads, and checks what can
be checked: a quaternion that is no unit quaternion and a matrix that is no rotation are refused.
"""
