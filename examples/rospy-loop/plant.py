#!/usr/bin/env python3
"""A ball on a plate, in one direction: it rolls as the plate is tilted. An ordinary node of Debian's rospy.

Publishes /state: position in m, velocity in m/s, and when they were so (CLOCK_MONOTONIC, s). Takes /command: the plate's
tilt in rad. A tilt of y accelerates the ball by -7 y m/s^2, as in the paper, and the plate tilts 32 degrees at most.
"""

import math
import time

import rospy
from std_msgs.msg import Float64, Float64MultiArray

RATE_HZ = 50
TILT_LIMIT = math.radians(32)
RIM_M = 3.1


class Plant:
    def __init__(self):
        self.tilt = 0.0
        self.position = 0.0
        self.velocity = 0.0
        rospy.Subscriber("/command", Float64, self.take, queue_size=1, tcp_nodelay=True)
        self.state = rospy.Publisher("/state", Float64MultiArray, queue_size=1)

    def take(self, command):
        self.tilt = max(-TILT_LIMIT, min(TILT_LIMIT, command.data))

    def step(self, seconds):
        """Exact for a tilt that stays as it is."""
        acceleration = -7 * self.tilt
        self.position += self.velocity * seconds + acceleration * seconds**2 / 2
        self.velocity += acceleration * seconds
        if abs(self.position) > RIM_M:
            self.position = math.copysign(RIM_M, self.position)
            self.velocity = 0.0

    def run(self):
        rate = rospy.Rate(RATE_HZ)
        last = time.monotonic()
        while not rospy.is_shutdown():
            now = time.monotonic()
            self.step(now - last)
            last = now
            self.state.publish(Float64MultiArray(data=[self.position, self.velocity, now]))
            try:
                rate.sleep()
            except rospy.ROSInterruptException:
                return


rospy.init_node("plant")
Plant().run()
