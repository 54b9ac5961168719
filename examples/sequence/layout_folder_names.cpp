// SPDX-License-Identifier: Apache-2.0
// The names that people give to the folders of their cameras.
#include <algorithm>
#include <cctype>
#include <filesystem>
#include <map>
#include <string>
#include <system_error>
#include <vector>

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

/// The folders with images in a folder, by their names in lower case: several of one name where
/// these differ in case alone.
using named_folders = std::map<std::string, std::vector<fs::path>>;

named_folders folders_in(fs::path const& root) {
  named_folders found;
  std::error_code failure;
  for (fs::directory_iterator it(root, failure), end; !failure && it != end;
       it.increment(failure)) {
    if (is_directory(it->path().string()) && !with_images(it->path()).empty()) {
      found[lower_case(it->path().filename().string())].push_back(it->path());
    }
  }
  for (auto& [name, folders] : found) { std::sort(folders.begin(), folders.end()); }
  return found;
}

/// Where the images of the folder of that name are; empty without. Two of one name are noted.
fs::path images_in(named_folders const& folders, std::string const& name, camera_folders& found) {
  auto const at = folders.find(name);
  if (at == folders.end()) { return {}; }
  if (at->second.size() > 1) {
    found.same_name =
        at->second[0].filename().string() + " and " + at->second[1].filename().string();
  }
  return with_images(at->second[0]);
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
void find_further(named_folders const& folders, std::string const& left, camera_folders& found) {
  if (left.compare(0, 3, "cam") != 0 || left.back() != '0') { return; }
  for (int k = 2; !found.right.empty(); ++k) {
    std::string const name = left.substr(0, left.size() - 1) + std::to_string(k);
    fs::path const next = images_in(folders, name, found);
    if (next.empty()) { break; }
    found.more.push_back(next);
  }
  for (int k = 0; k < 2 + static_cast<int>(found.more.size()); ++k) {
    fs::path const depth = images_in(folders, "depth" + std::to_string(k), found);
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
  named_folders const folders = folders_in(root);
  for (auto const& [left, right] : pairs) {
    camera_folders found;
    found.left = images_in(folders, left, found);
    if (found.left.empty()) { continue; }
    found.right = images_in(folders, right, found);
    found.right_name = right;
    find_further(folders, left, found);
    return found;
  }
  camera_folders named;
  for (auto const& [left, same] : folders) {
    std::string const right = right_of(left);
    if (folders.count(right) == 0) { continue; }
    if (!named.left.empty()) {
      named.other_pair = same[0].filename().string();
      continue;
    }
    named.left = images_in(folders, left, named);
    named.right = images_in(folders, right, named);
    named.right_name = right;
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
