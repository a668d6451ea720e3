"""A plant of one's own, in rospy, in place of the workload's: see docs/ros.md.

It says `following` when the ball has stayed near the reference for a second, and then goes on.
"""
import math

import rospy
from std_msgs.msg import Float64MultiArray

RATE_HZ = 50
B1, B0, GEAR = 0.01176, 0.58823, 16
SUBSTEPS = 20


class Axis:
    def __init__(self):
        self.position = self.speed = self.angle = self.rate = 0.0

    def step(self, voltage):
        h = 1.0 / RATE_HZ / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.rate += h * (voltage - B0 * self.rate) / B1
            self.angle += h * self.rate
            self.speed += h * -7 * self.angle / GEAR
            self.position += h * self.speed


command = [0.0, 0.0, 0.0, 0.0]


def receive(message):
    global command
    command = message.data


rospy.init_node("plant", disable_rosout=True)
rospy.Subscriber("/command", Float64MultiArray, receive, tcp_nodelay=True)
states = rospy.Publisher("/state", Float64MultiArray, queue_size=10)
x, y = Axis(), Axis()
rate = rospy.Rate(RATE_HZ)
seq = near = 0
while not rospy.is_shutdown():
    seq += 1
    data = [float(seq), rospy.get_time()]
    for axis in (x, y):
        data += [axis.position, axis.speed, axis.angle, axis.rate]
    states.publish(Float64MultiArray(data=data))
    _, stamp, x_v, y_v = command
    x.step(x_v)
    y.step(y_v)
    phase = 2 * math.pi * stamp / 100
    wanted = 2 * math.cos(phase) * math.sin(2 * phase), 2 * math.cos(phase) * math.sin(phase)
    distance = math.hypot(wanted[0] - x.position, wanted[1] - y.position)
    # At the very beginning everything is at zero, controller or not.
    near = near + 1 if distance < 0.5 and abs(wanted[0]) > 0.7 else 0
    if near == RATE_HZ:
        print("following", flush=True)
    rate.sleep()
