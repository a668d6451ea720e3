"""A controller of one's own, in rospy, that speaks the texts of `dynamics: author`: see docs/ros.md.

It holds the ball at x = 1 m, y = -0.5 m, with backward differences of what it received, and says `following` when the ball
has been near for a second.
"""
import math

import rospy
from std_msgs.msg import String

WANTED = 1.0, -0.5
H = 0.02
state = None


def receive(message):
    global state
    state = [float(number) for number in message.data.strip("[]").split()]


rospy.init_node("controller", disable_rosout=True)
rospy.Subscriber("plant_state", String, receive)
commands = rospy.Publisher("control_action", String, queue_size=10)
rate = rospy.Rate(1 / H)
action = [0.0, 0.0]
before = None
near = 0
begun = rospy.get_time()
while not rospy.is_shutdown():
    text = "/u?&value0=%.4f&value1=%.4f&time=%.6f&access=8783392&]"
    commands.publish(text % (action[0], action[1], rospy.get_time() - begun))
    if state is not None:
        now = state[:4]
        last = before or now
        for axis in (0, 1):
            plate = -1.312 * (WANTED[axis] - now[axis]) + 1.299 * (now[axis] - last[axis]) / H
            plate = max(-0.05, min(0.05, plate))
            action[axis] = 5.79 * (16 * plate - now[2 + axis]) - 0.22 * (now[2 + axis] - last[2 + axis]) / H
        before = now
        distance = math.hypot(WANTED[0] - now[0], WANTED[1] - now[1])
        near = near + 1 if distance < 0.4 else 0
        if near == 50:
            print("following", flush=True)
    rate.sleep()
