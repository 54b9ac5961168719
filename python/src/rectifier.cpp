// SPDX-License-Identifier: Apache-2.0
#include "ft/kernels/images/rectify.hpp"

#include "ft/cameras/distorted_pair.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/kernels/images/build_remap.hpp"
#include "python/src/conversions.hpp"

namespace ftpy::FTPY_DEVICE {
namespace {

using pair_type = ft::distorted_pair<ft::radtan8<float>>;

class rectifier_of final : public rectifier, private executor {
public:
  rectifier_of(pair_type const& rig, int width, int height, int threads)
      : executor(threads),
        rig_(rig),
        table_({width, height, rig.width > 0 ? rig.width : width,
                rig.height > 0 ? rig.height : height},
               2),
        given_(copies * source_pixels()),
        made_(copies * pixels()) {
    auto const& wanted = rig.target.camera;
    ft::build_remap(exec, rig.left, rig.R_left.transposed(), wanted, table_.view(), 0);
    ft::build_remap(exec, rig.right, rig.R_right.transposed(), wanted, table_.view(), 1);
    exec.wait();
  }

  void wait_for(std::uintptr_t stream) override { wait_for_stream(stream); }
  void rectify(image const (&given)[2], rectified_image const (&out)[2],
               std::uint8_t border) override {
    translated([&] {
      for (int i = 0; i < 2; ++i) { rectify_one(i, to_ft(given[i]), out[i], border); }
      exec.wait();
    });
  }
  std::shared_ptr<std::uint8_t> make_image() const override {
    using memory = ft::buffer<std::uint8_t, exec_type::space>;
    auto const owned = std::make_shared<memory>(pixels());
    return {owned, owned->data()};
  }
  rectification map(int camera) const override {
    ft::remap_table_view const from = table_.view().slice(camera);
    rectification r;
    std::vector<ft::remap_position> position(pixels());
    r.fraction.resize(pixels());
    ft::copy(exec, position.data(), static_cast<ft::remap_position const*>(from.position),
             position.size());
    ft::copy(exec, r.fraction.data(), static_cast<std::uint16_t const*>(from.fraction),
             r.fraction.size());
    exec.wait();
    for (ft::remap_position const p : position) { r.position.insert(r.position.end(), {p.x, p.y}); }
    auto const& R = camera == 0 ? rig_.R_left : rig_.R_right;
    std::copy(R.m, R.m + 9, r.R.begin());
    return r;
  }
  int device() const override { return executor::device; }
  double baseline() const override { return rig_.target.baseline; }

private:
  /// Images that the executor may have to fetch or bring.
  static constexpr std::size_t copies = exec_type::space == ft::memory_space::device ? 2 : 0;

  std::size_t pixels() const { return static_cast<std::size_t>(table_.view().pixels()); }
  std::size_t source_pixels() const {
    auto const& s = table_.view().sizes;
    return static_cast<std::size_t>(s.source_width) * static_cast<std::size_t>(s.source_height);
  }
  /// Through memory of its own where the executor cannot read or write that of the caller.
  void rectify_one(int i, ft::gray_view from, rectified_image const& out, std::uint8_t border) {
    auto const k = static_cast<std::size_t>(i);
    auto const& s = table_.view().sizes;
    auto const* const data = static_cast<std::uint8_t const*>(exec_type::host_address(from.data));
    if (data != nullptr) {
      from.data = data;
    } else {
      ft::image_view<std::uint8_t> const copied{given_.data() + k * source_pixels(), s.source_width,
                                                s.source_height, s.source_width};
      ft::copy_image(exec, copied, from);
      from = copied;
    }
    ft::image_view<std::uint8_t> const to{out.data, s.width, s.height, out.stride};
    bool const direct = exec_type::host_address(out.data) != nullptr;
    ft::image_view<std::uint8_t> const target =
        direct
            ? to
            : ft::image_view<std::uint8_t>{made_.data() + k * pixels(), s.width, s.height, s.width};
    ft::rectify(exec, {from.data, from.width, from.height, from.stride, 0, 1},
                table_.view().slice(i),
                {target.data, target.width, target.height, target.stride, 0, 1}, border);
    if (!direct) { ft::copy_image(exec, to, target); }
  }

  pair_type rig_;
  ft::remap_table<exec_type::space> table_;
  ft::buffer<std::uint8_t, exec_type::space> given_, made_;
};

}  // namespace

std::unique_ptr<rectifier> make_rectifier(rig const& of, int width, int height, int threads) {
  return translated([&]() -> std::unique_ptr<rectifier> {
    if (of.kind != "distorted") { throw argument_error("only an ft.DistortedPair is rectified"); }
    return std::make_unique<rectifier_of>(distorted_of(of), width, height, threads);
  });
}

}  // namespace ftpy::FTPY_DEVICE
