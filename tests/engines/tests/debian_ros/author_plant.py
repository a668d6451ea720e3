"""A plant of one's own, in rospy, that speaks the texts of `dynamics: author`: see docs/ros.md.

It answers each command with its state and the command's time stamp, and says `following` when the ball has been within
half a metre of the reference for a second, well away from the middle.
"""
import math
import threading

import rospy
from std_msgs.msg import String

H = 0.02
B1, B0, GEAR = 0.01176, 0.58823, 16
SUBSTEPS = 20


class Axis:
    def __init__(self):
        self.position = self.speed = self.angle = self.rate = self.voltage = 0.0

    def step(self):
        h = H / SUBSTEPS
        for _ in range(SUBSTEPS):
            self.rate += h * (self.voltage - B0 * self.rate) / B1
            self.angle += h * self.rate
            self.speed += h * -7 * self.angle / GEAR
            self.position += h * self.speed


lock = threading.Lock()
x, y = Axis(), Axis()
clock = 0.0


def answer(message):
    global clock
    fields = message.data.split("]")[-2].split("?")[1].split("&")
    x_v, y_v, stamp = (float(field.split("=")[1]) for field in fields[1:4])
    with lock:
        x.voltage, y.voltage, clock = x_v, y_v, stamp
        text = "[%.4f %.4f %.4f %.4f %.6f]" % (x.position, y.position, x.angle, y.angle, stamp)
    states.publish(text)


rospy.init_node("plant", disable_rosout=True)
states = rospy.Publisher("plant_state", String, queue_size=10)
rospy.Subscriber("control_action", String, answer)
rate = rospy.Rate(1 / H)
near = 0
while not rospy.is_shutdown():
    with lock:
        x.step()
        y.step()
        phase = 2 * math.pi * clock / 100
    wanted = 2 * math.cos(phase) * math.sin(2 * phase), 2 * math.cos(phase) * math.sin(phase)
    distance = math.hypot(wanted[0] - x.position, wanted[1] - y.position)
    near = near + 1 if distance < 0.5 and abs(wanted[0]) > 0.7 else 0
    if near == 50:
        print("following", flush=True)
    rate.sleep()
