"""Wire protocols as pure functions: bytes in, numbers out; no sockets, no threads, no ROS."""
