// SPDX-License-Identifier: Apache-2.0
// The names that people give to the folders of their cameras.
#include <filesystem>
#include <string>
#include <system_error>

#include "examples/sequence/detail/layout.hpp"

namespace seq::detail {

namespace fs = std::filesystem;

fs::path with_images(fs::path const& folder) {
  for (fs::path const& candidate : {folder, folder / "data"}) {
    std::error_code failure;
    for (fs::directory_iterator it(candidate, failure), end; !failure && it != end;
         it.increment(failure)) {
      if (has_image_extension(it->path())) { return candidate; }
    }
  }
  return {};
}

camera_folders find_camera_folders(fs::path const& root) {
  constexpr char const* pairs[][2] = {{"left", "right"},
                                      {"Left", "Right"},
                                      {"cam0", "cam1"},
                                      {"image_0", "image_1"},
                                      {"image_2", "image_3"},
                                      {"image_left", "image_right"},
                                      {"camera0", "camera1"},
                                      {"image_00", "image_01"},
                                      {"image_02", "image_03"},
                                      {"infra1", "infra2"},
                                      {"left_images", "right_images"}};
  for (auto const& [left, right] : pairs) {
    fs::path const first = with_images(root / left);
    if (first.empty()) { continue; }
    camera_folders found{first, with_images(root / right), right, {}};
    std::string const name = left;
    for (int k = 2; name.rfind("cam", 0) == 0 && !found.right.empty(); ++k) {
      fs::path const next =
          with_images(root / (name.substr(0, name.size() - 1) + std::to_string(k)));
      if (next.empty()) { break; }
      found.more.push_back(next);
    }
    for (int k = 0; name.rfind("cam", 0) == 0 && k < 2 + static_cast<int>(found.more.size()); ++k) {
      fs::path const depth = with_images(root / ("depth" + std::to_string(k)));
      if (!depth.empty()) { found.depths.emplace_back(k, depth); }
    }
    return found;
  }
  for (char const* name : {"images", "image", "rgb", "color", "frames", ""}) {
    fs::path const first = with_images(name[0] == 0 ? root : root / name);
    if (!first.empty()) { return {first, {}, {}, {}}; }
  }
  return {};
}

bool has_image_folders(fs::path const& root) { return !find_camera_folders(root).left.empty(); }

}  // namespace seq::detail
