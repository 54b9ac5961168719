// SPDX-License-Identifier: Apache-2.0
/// @file The calls in the constructors of Frame, which take a pointer: with nullptr the CPU does
/// everything, as for the first frames of a monocular system.
#pragma once

#include <vector>

namespace ft {
namespace orbslam3 {

template <typename Types>
class front_end;

template <typename Types, typename Cpu, typename... Images>
void extract(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu,
             Images const&... images) {
  if (gpu == nullptr) { return cpu(); }
  gpu->extract(frame, cpu, images...);
}
template <typename Types, typename Cpu>
void undistort(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  if (gpu == nullptr) { return cpu(); }
  gpu->undistort(frame, cpu);
}
template <typename Types, typename Cpu>
void assign_to_grid(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  if (gpu == nullptr) { return cpu(); }
  gpu->assign_to_grid(frame, cpu);
}
template <typename Types, typename Cpu, typename Image>
void stereo(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu,
            std::vector<Image>& left, std::vector<Image>& right) {
  if (gpu == nullptr) { return cpu(); }
  gpu->stereo(frame, cpu, left, right);
}
template <typename Types, typename Cpu>
void stereo_fisheye(front_end<Types>* gpu, typename Types::frame& frame, Cpu const& cpu) {
  if (gpu == nullptr) { return cpu(); }
  gpu->stereo_fisheye(frame, cpu);
}

}  // namespace orbslam3
}  // namespace ft
