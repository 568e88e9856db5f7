"""The operator's page: web server and data feed, without ROS."""
