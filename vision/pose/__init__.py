"""Pose of marks in a plane: ArUco marks and ChArUco boards, by the detectors of OpenCV.

Pixel positions in this package are those of OpenCV: the centre of the first pixel is (0, 0).
Positions in the plane are in mm, x to the right along the upper side of a mark as it is printed,
y up; angles in degrees, positive anticlockwise as the camera sees the plane.
"""
