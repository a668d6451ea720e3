"""Subscribes to /state and says how many have come. Ends when one is missing."""
import os
import sys

import rospy
from std_msgs.msg import Float64MultiArray

last = count = 0


def receive(message):
    global last, count
    seq = int(message.data[0])
    if last and seq != last + 1:
        print("missing from", last, "to", seq, flush=True)
        os._exit(1)
    last = seq
    count += 1
    if count % 50 == 0:
        print("received", count, flush=True)


rospy.init_node(sys.argv[1], disable_rosout=True)
rospy.Subscriber("/state", Float64MultiArray, receive, tcp_nodelay="nodelay" in sys.argv)
rospy.spin()
