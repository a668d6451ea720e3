#!/usr/bin/env python3
"""Keeps the ball on its path over the network, and measures how well. An ordinary node of Debian's rospy.

    controller.py PERIODS FOLDER

Takes /state and publishes /command, as plant.py has them. The ball is to follow 0.25 m * sin(2 pi t / 2 s),
which takes 2.5 m/s^2 of the 3.9 m/s^2 that the tilted plate can give. Writes
FOLDER/periods.csv: for each period of 2 s the mean distance from the path, in mm, and the mean age of the state that a step
worked with, in ms. The first two periods, in which the ball rolls from rest onto its path, are left out.
"""

import math
import sys
import time

import rospy
from std_msgs.msg import Float64, Float64MultiArray

RATE_HZ = 50
PERIOD_S = 2.0
AMPLITUDE_M = 0.25
LEFT_OUT = 2
# Of a double integrator with -7: critically damped at 6 rad/s.
KP = 36 / 7
KD = 12 / 7

latest = None


def take(state):
    global latest
    latest = state.data


def main(periods, folder):
    rospy.init_node("controller")
    command = rospy.Publisher("/command", Float64, queue_size=1)
    rospy.Subscriber("/state", Float64MultiArray, take, queue_size=1, tcp_nodelay=True)
    rate = rospy.Rate(RATE_HZ)
    while latest is None or command.get_num_connections() == 0:
        rate.sleep()
    steps = round(PERIOD_S * RATE_HZ)
    omega = 2 * math.pi / PERIOD_S
    begun = time.monotonic()
    rows = []
    for _ in range(LEFT_OUT + periods):
        distance_mm = age_ms = 0.0
        for _ in range(steps):
            now = time.monotonic()
            position, velocity, stamp = latest
            at = omega * (now - begun)
            wanted, wanted_velocity = AMPLITUDE_M * math.sin(at), AMPLITUDE_M * omega * math.cos(at)
            ahead = -AMPLITUDE_M * omega**2 * math.sin(at)
            tilt = -(KP * (wanted - position) + KD * (wanted_velocity - velocity) + ahead / 7)
            command.publish(Float64(tilt))
            # Where the ball was when it was seen, and where it was to be then.
            seen = AMPLITUDE_M * math.sin(omega * (stamp - begun))
            distance_mm += 1000 * abs(seen - position) / steps
            age_ms += 1000 * (now - stamp) / steps
            rate.sleep()
        rows.append((distance_mm, age_ms))
    with open(f"{folder}/periods.csv", "w") as file:
        print("error_mm,age_ms", file=file)
        for row in rows[LEFT_OUT:]:
            print("%.6f,%.6f" % row, file=file)


main(int(sys.argv[1]), sys.argv[2])
