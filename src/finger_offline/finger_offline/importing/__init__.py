# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Session bags from a laboratory's own files: `finger-bag import`.

`settings` (what to import), `tables` (columns of CSV, Parquet, Excel, HDF5, MATLAB, NumPy and XDF
files), `pictures` (videos and folders of images), `trial` (one recording → one bag), `command`.
"""
