# Finger contact suite on Ubuntu 24.04 with ROS 2 Jazzy from apt. Building it has not been tested.
# tests/test_colcon.py builds the same workspace and runs its commands.
#
#   docker build -t finger-contact .
#   docker run --rm -it --network host finger-contact finger-rig up --simulated
FROM ros:jazzy-ros-base

RUN apt-get update && apt-get install -y --no-install-recommends \
      build-essential make python3-venv python3-pip python3-colcon-common-extensions \
      ros-jazzy-diagnostic-msgs ros-jazzy-sensor-msgs ros-jazzy-rosbag2-storage-mcap \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /finger
COPY requirements.txt ./
# Ubuntu 24.04 refuses pip outside a virtual environment (PEP 668); this one sees apt's rclpy, which
# is built for NumPy 1.
RUN python3 -m venv --system-site-packages venv \
    && venv/bin/pip install --no-cache-dir -r requirements.txt "numpy<2" \
         "opencv-python-headless<4.11" colcon-common-extensions "setuptools<80"

COPY . .
# The commands are in install/PACKAGE/lib/PACKAGE, where `ros2 run` looks; the links put those for
# people (finger-…) on the PATH as well.
RUN . /opt/ros/jazzy/setup.sh && . venv/bin/activate && python -m colcon build --base-paths src \
    && scripts/link_commands.sh install /usr/local/bin \
    && printf '%s\n' '#!/bin/sh' '. /opt/ros/jazzy/setup.sh' '. /finger/venv/bin/activate' \
         '. /finger/install/setup.sh' 'exec "$@"' > /entry.sh \
    && chmod +x /entry.sh

ENTRYPOINT ["/entry.sh"]
CMD ["finger-rig", "up", "--simulated"]
