// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/masks.hpp"

#include <algorithm>
#include <filesystem>
#include <map>
#include <system_error>
#include <utility>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/image_io.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

/// The masks of a folder by the names of their images: those without the last extension, and with
/// it.
std::map<std::string, std::string> masks_by_name(fs::path const& folder) {
  std::map<std::string, std::string> masks;
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    std::string const path = it->path().string();
    auto const at = masks.emplace(it->path().stem().string(), path).first;
    at->second = std::min(at->second, path);  // whatever the order of the folder
  }
  return masks;
}

/// Of a mask of all frames. @throws error if no pixel is left
void tell_of_little(std::string const& path, image const& mask,
                    std::vector<std::string>& warnings) {
  std::size_t const all = mask.pixels.size();
  auto const covered =
      static_cast<std::size_t>(std::count(mask.pixels.begin(), mask.pixels.end(), 0));
  if (covered == all) {
    throw error(path + ": the mask is 0 everywhere, where no keypoints are wanted; accepted are " +
                "masks that are 0 on what is fixed to the camera and not 0 elsewhere");
  }
  if ((all - covered) * 10 < all) {
    warnings.push_back(path + ": the mask is 0, where no keypoints are wanted, on " +
                       std::to_string(covered * 100 / all) + " % of the image");
  }
}

}  // namespace

camera_masks::camera_masks(std::string const& path, std::vector<std::string> const& images,
                           camera_intrinsics const& raw, move_image move,
                           std::vector<std::string>& warnings)
    : raw_(raw), move_(std::move(move)) {
  if (path.empty()) { return; }
  std::error_code failure;
  if (!fs::is_directory(path, failure)) {
    fixed_ = std::make_shared<image const>(read(path));
    tell_of_little(path, *fixed_, warnings);
    return;
  }
  std::map<std::string, std::string> const masks = masks_by_name(path);
  std::size_t missing = 0;
  for (std::string const& file : images) {
    auto found = masks.find(fs::path(file).stem().string());
    if (found == masks.end()) { found = masks.find(fs::path(file).filename().string()); }
    files_.push_back(found == masks.end() ? std::string() : found->second);
    missing += static_cast<std::size_t>(found == masks.end() && !file.empty());
  }
  if (std::all_of(files_.begin(), files_.end(), [](auto const& f) { return f.empty(); })) {
    throw error(path +
                ": no mask of an image; accepted are an image, and a folder with masks that " +
                "have the names of the camera's images, such as " +
                fs::path(images.front()).stem().string() + ".png");
  }
  if (missing > 0) {
    warnings.push_back(path + ": " + std::to_string(missing) + " of " +
                       std::to_string(images.size()) +
                       " frames have no mask: all of their image is used");
  }
}

camera_masks::mask camera_masks::of(std::size_t i) const {
  if (fixed_ != nullptr || files_.empty() || files_[i].empty()) { return fixed_; }
  return std::make_shared<image const>(read(files_[i]));
}

/// Of 0 and 255. A pixel that is moved is allowed where all pixels are that it comes from.
image camera_masks::read(std::string const& path) const {
  image loaded = read_image(path, 8);
  check_image_size(path, loaded.width, loaded.height, raw_);
  auto const sharpen = [&](std::uint8_t least) {
    for (std::uint8_t& v : loaded.pixels) { v = v >= least ? 255 : 0; }
  };
  sharpen(1);
  if (move_) {
    loaded = move_(loaded);
    sharpen(255);
  }
  return loaded;
}

}  // namespace seq::detail
