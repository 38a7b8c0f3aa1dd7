"""A rosbridge v2 server for services, over WebSocket, on loopback: ROS clients call without ROS here.

Source: the rosbridge v2.0 protocol specification of RobotWebTools, which roslibpy and roslibjs speak.
"""

from demoplan.engines.rosbridge.protocol import Reply, Service, answers
from demoplan.engines.rosbridge.server import RunningServer, serve, start

__all__ = ["Reply", "RunningServer", "Service", "answers", "serve", "start"]
