# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Drivers of `temperature_acquisition`: bring readings from elsewhere to `sensor_readings`.

A driver publishes raw readings on the topic that the component reads, so that a bag holds them
and a replay needs no driver.
"""
