// SPDX-License-Identifier: Apache-2.0
#include "examples/common/scene.hpp"

#include <utility>

#include "examples/sequence/generator.hpp"
#include "examples/sequence/image_io.hpp"

namespace demo {

namespace {

grey_image to_grey(seq::image image) {
  return {image.width, image.height, std::move(image.pixels)};
}

seq::generator_options options_of(int frames, int width) {
  seq::generator_options options;
  options.frames = frames;
  options.width = width;
  return options;
}

}  // namespace

struct scene::impl {
  seq::generator source;
};

scene::scene(int frames, int width) : impl_(new impl{seq::generator(options_of(frames, width))}) {}
scene::scene(scene&&) noexcept = default;
scene& scene::operator=(scene&&) noexcept = default;
scene::~scene() = default;

int scene::frames() const { return impl_->source.size(); }
int scene::width() const { return impl_->source.rig().left.width; }
int scene::height() const { return impl_->source.rig().left.height; }

std::array<float, 4> scene::intrinsics() const {
  auto const& camera = impl_->source.rig().left;
  return {static_cast<float>(camera.fx), static_cast<float>(camera.fy),
          static_cast<float>(camera.cx), static_cast<float>(camera.cy)};
}

float scene::baseline() const { return static_cast<float>(impl_->source.rig().baseline()); }

image_pair scene::render(int frame) const {
  auto pair = impl_->source.render(frame);
  return {to_grey(std::move(pair.left)), to_grey(std::move(pair.right))};
}

image_pair scene::render(int frame, mounting const& other) const {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.rotate(Eigen::AngleAxisd(other.turn, Eigen::Vector3d::UnitY()));
  T.translation() = Eigen::Vector3d(other.centre[0], other.centre[1], other.centre[2]);
  auto pair = impl_->source.render(frame, T);
  return {to_grey(std::move(pair.left)), to_grey(std::move(pair.right))};
}

double scene::depth(int frame, double u, double v) const {
  return impl_->source.depth(frame, u, v);
}

std::array<double, 3> scene::centre(int frame) const {
  Eigen::Vector3d const at =
      impl_->source.T_world_camera(0).inverse() * impl_->source.T_world_camera(frame).translation();
  return {at.x(), at.y(), at.z()};
}

grey_image read_image(std::string const& path) { return to_grey(seq::read_image(path)); }

}  // namespace demo
