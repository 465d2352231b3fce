# The README's installation on Ubuntu 24.04, step by step:
#
#     docker build -t redundant_planner .
#     docker run --rm -it --network host redundant_planner
#
# It has been linted (hadolint), but not yet built: where it was written there is no registry.
FROM ros:jazzy
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws

# The packages of Ubuntu and ROS 2, anew only when package.xml changes. They come in the versions
# that Jazzy has today. rosdep would install the skipped keys into the system; they follow below.
COPY package.xml src/redundant_planner/
# hadolint ignore=DL3008
RUN apt-get update && \
    apt-get install -y --no-install-recommends python3-venv && \
    rosdep update --rosdistro jazzy && \
    rosdep install --from-paths src --ignore-src -y \
        --skip-keys "python3-numba python3-rosbags-pip python3-mujoco-pip" && \
    rm -rf /var/lib/apt/lists/*
RUN python3 -m venv --system-site-packages venv && touch venv/COLCON_IGNORE && \
    venv/bin/pip install --no-cache-dir \
        'daqp>=0.5' 'numba>=0.59,<0.69' 'rosbags>=0.10' 'plotly>=5.15' 'mujoco>=3.2'

COPY . src/redundant_planner
RUN source /opt/ros/jazzy/setup.bash && venv/bin/python -m colcon build && \
    source install/setup.bash && venv/bin/python -m redundant_planner.compile

ENTRYPOINT ["/bin/bash", "-c", "source /ws/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "launch", "redundant_planner", "demo.launch.py"]
