// SPDX-License-Identifier: Apache-2.0
int track_one_frame();
int main() { return track_one_frame(); }
