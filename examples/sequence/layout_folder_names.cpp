// SPDX-License-Identifier: Apache-2.0
// The names that people give to the folders of their cameras.
#include <algorithm>
#include <cctype>
#include <filesystem>
#include <map>
#include <string>
#include <system_error>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/text.hpp"

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

namespace {

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// The folders in a folder, by their names in lower case.
std::map<std::string, fs::path> folders_in(fs::path const& root) {
  std::map<std::string, fs::path> found;
  std::error_code failure;
  for (fs::directory_iterator it(root, failure), end; !failure && it != end;
       it.increment(failure)) {
    if (is_directory(it->path().string())) {
      found.emplace(lower_case(it->path().filename().string()), it->path());
    }
  }
  return found;
}

/// "cam_right" for "cam_left", as for any other name of which that is the last word; else empty.
std::string right_of(std::string const& left) {
  std::string const word = "left";
  bool const ends = left.size() > word.size() + 1 &&
                    left.compare(left.size() - word.size(), word.size(), word) == 0;
  if (!ends) { return {}; }
  std::size_t const at = left.size() - word.size();
  bool const apart = left[at - 1] == '_' || left[at - 1] == '-' || left[at - 1] == ' ';
  return apart ? left.substr(0, at) + "right" : std::string();
}

/// cam2 ... and depth0 ... beside cam0 and cam1.
void find_further(fs::path const& root, std::string const& left, camera_folders& found) {
  if (left.compare(0, 3, "cam") != 0 || left.back() != '0') { return; }
  for (int k = 2; !found.right.empty(); ++k) {
    fs::path const next = with_images(root / (left.substr(0, left.size() - 1) + std::to_string(k)));
    if (next.empty()) { break; }
    found.more.push_back(next);
  }
  for (int k = 0; k < 2 + static_cast<int>(found.more.size()); ++k) {
    fs::path const depth = with_images(root / ("depth" + std::to_string(k)));
    if (!depth.empty()) { found.depths.emplace_back(k, depth); }
  }
}

}  // namespace

camera_folders find_camera_folders(fs::path const& root) {
  constexpr char const* pairs[][2] = {{"left", "right"},
                                      {"cam0", "cam1"},
                                      {"image_0", "image_1"},
                                      {"image_2", "image_3"},
                                      {"image_left", "image_right"},
                                      {"camera0", "camera1"},
                                      {"image_00", "image_01"},
                                      {"image_02", "image_03"},
                                      {"infra1", "infra2"},
                                      {"left_images", "right_images"}};
  std::map<std::string, fs::path> const folders = folders_in(root);
  auto const images_in = [&](std::string const& name) {
    auto const at = folders.find(name);
    return at == folders.end() ? fs::path() : with_images(at->second);
  };
  for (auto const& [left, right] : pairs) {
    fs::path const first = images_in(left);
    if (first.empty()) { continue; }
    camera_folders found{first, images_in(right), right, {}};
    find_further(root, left, found);
    return found;
  }
  camera_folders named;
  for (auto const& [left, folder] : folders) {
    std::string const right = right_of(left);
    fs::path const first = right.empty() ? fs::path() : with_images(folder);
    fs::path const second = first.empty() ? fs::path() : images_in(right);
    if (second.empty()) { continue; }
    if (named.left.empty()) {
      named = {first, second, right, {}};
    } else {
      named.other_pair = folder.filename().string();
    }
  }
  if (!named.left.empty()) { return named; }
  for (char const* name : {"images", "image", "rgb", "color", "frames", ""}) {
    fs::path const first = with_images(name[0] == 0 ? root : root / name);
    if (!first.empty()) { return {first, {}, {}, {}}; }
  }
  return {};
}

bool has_image_folders(fs::path const& root) { return !find_camera_folders(root).left.empty(); }

}  // namespace seq::detail
