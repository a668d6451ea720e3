"""A controller of one's own, in rospy, in place of the workload's: see docs/ros.md.

It holds the ball at x = 1 m, y = -0.5 m, and says `following` when it has been there for a second.
"""
import math

import rospy
from std_msgs.msg import Float64MultiArray

WANTED = 1.0, -0.5
state = None


def receive(message):
    global state
    state = message.data


def voltage(wanted, position, speed, angle, rate):
    plate = -1.312 * (wanted - position) + 1.299 * speed
    return 5.79 * (16 * plate - angle) - 0.22 * rate


rospy.init_node("controller", disable_rosout=True)
rospy.Subscriber("/state", Float64MultiArray, receive, tcp_nodelay=True)
commands = rospy.Publisher("/command", Float64MultiArray, queue_size=10)
rate = rospy.Rate(50)
seq = near = 0
while not rospy.is_shutdown():
    if state is not None:
        seq += 1
        x, y = state[2:6], state[6:10]
        voltages = [voltage(wanted, *axis) for wanted, axis in zip(WANTED, (x, y))]
        commands.publish(Float64MultiArray(data=[float(seq), rospy.get_time()] + voltages))
        distance = math.hypot(WANTED[0] - x[0], WANTED[1] - y[0])
        near = near + 1 if distance < 0.3 else 0
        if near == 50:
            print("following", flush=True)
    rate.sleep()
