// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

/// An image and the number in its name: "left_000012" has 000012, "1305031102.1753" the whole.
struct named_image {
  std::string file;
  std::string number;
};

/// The longest number in a text, of equal ones the last; with its decimal part.
std::string number_in(std::string const& text) {
  std::string longest;
  for (std::size_t i = 0; i < text.size();) {
    if (!is_digit(text[i])) {
      ++i;
      continue;
    }
    std::size_t end = i;
    bool point = false;
    while (end < text.size() &&
           (is_digit(text[end]) ||
            (!point && text[end] == '.' && end + 1 < text.size() && is_digit(text[end + 1])))) {
      point = point || text[end] == '.';
      ++end;
    }
    if (end - i >= longest.size()) { longest = text.substr(i, end - i); }
    i = end;
  }
  return longest;
}

/// A frame's number of at most nine digits; nothing for anything else.
std::optional<std::int64_t> counter_of(named_image const& image) {
  bool const whole = !image.number.empty() && image.number.size() <= 9 &&
                     image.number.find('.') == std::string::npos;
  if (!whole) { return std::nullopt; }
  return std::stoll(image.number);
}

/// Two images whose names differ in letters alone are of two cameras, or colour and depth: taken as
/// one camera's they would alternate. @throws seq::error
void check_numbers(std::vector<named_image> const& images, fs::path const& folder) {
  std::map<std::string, std::string> found;  // the digits of a name
  for (named_image const& image : images) {
    std::string const name = fs::path(image.file).filename().string();
    std::string digits = fs::path(image.file).stem().string();
    if (image.number.empty()) { continue; }
    std::replace_if(
        digits.begin(), digits.end(), [](char c) { return !is_digit(c); }, ' ');
    digits = trim(digits);
    auto const [place, added] = found.emplace(digits, name);
    if (added) { continue; }
    throw error(folder.string() + ": " + place->second + " and " + name +
                " have one number; accepted are one image of each number in a folder, a folder for "
                "each camera (left and right, cam0 and cam1), and frame-000000.color.png with "
                "frame-000000.depth.png (7-Scenes)");
  }
}

/// The images of a folder, by their numbers where each has one of its own, else by name.
/// @throws seq::error for two of one number
std::vector<named_image> list_images(fs::path const& folder) {
  std::vector<named_image> images;
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    if (!has_image_extension(it->path()) || !is_file(it->path().string())) { continue; }
    images.push_back({it->path().string(), number_in(it->path().stem().string())});
  }
  check_numbers(images, folder);
  std::set<std::int64_t> numbers;
  for (named_image const& image : images) {
    if (auto const n = counter_of(image)) { numbers.insert(*n); }
  }
  bool const numbered = numbers.size() == images.size();
  std::sort(images.begin(), images.end(), [&](named_image const& a, named_image const& b) {
    return numbered ? *counter_of(a) < *counter_of(b) : a.file < b.file;
  });
  return images;
}

/// The file with the times of the images; empty without any.
std::string find_times(fs::path const& root, fs::path const& left) {
  for (fs::path const& folder : {root, left, left.parent_path()}) {
    for (char const* name : {"times.txt", "timestamps.txt"}) {
      std::string const path = (folder / name).string();
      if (is_file(path)) { return path; }
    }
  }
  return {};
}

/// Images whose names are times. @throws seq::error for numbers of frames
std::vector<listed_image> by_name(std::vector<named_image> const& images, fs::path const& folder,
                                  layout_of_files& layout) {
  std::vector<std::pair<int, std::string>> texts;
  std::vector<std::int64_t> counters;
  for (named_image const& image : images) {
    if (auto const n = counter_of(image)) { counters.push_back(*n); }
    texts.emplace_back(static_cast<int>(texts.size()) + 1, image.number);
  }
  bool const any_without = std::any_of(images.begin(), images.end(),
                                       [](named_image const& i) { return i.number.empty(); });
  constexpr std::int64_t least_step = 5;  // of times; frames are counted one by one, or nearly so
  bool const counted = counters.size() == images.size() && median_step(counters) < least_step;
  if (images.empty()) { throw error(folder.string() + ": no images"); }
  if (any_without || counted) {
    throw error(folder.string() + ": the file names are no times (" +
                fs::path(images.front().file).filename().string() +
                "): a rate (--fps) or a file with times (--times, times.txt) says them");
  }
  std::string unit;
  std::vector<std::int64_t> const times =
      times_of_texts(texts, folder.string(), unit, layout.warnings);
  layout.stamps_from = "file names, " + unit;
  std::vector<listed_image> listed;
  for (std::size_t const i :
       ordered_lines(times, disordered::sorted, folder.string(), "images", layout.warnings)) {
    listed.push_back({times[i], images[i].file});
  }
  return listed;
}

/// The numbers of images in a sequence of frames.
std::vector<std::int64_t> counters_of(std::vector<named_image> const& images) {
  std::vector<std::int64_t> numbers;
  for (named_image const& image : images) {
    auto const n = counter_of(image);
    if (!n || (!numbers.empty() && *n <= numbers.back())) { return {}; }
    numbers.push_back(*n);
  }
  return numbers;
}

/// Frame times by the rate, or of the lines of a file. @param numbers of the images, ascending
std::vector<std::int64_t> frame_times(std::vector<std::int64_t> const& numbers,
                                      std::string const& path, open_options const& options,
                                      layout_of_files& layout) {
  std::vector<std::int64_t> times;
  if (path.empty()) {
    std::int64_t step = std::numeric_limits<std::int64_t>::max();
    for (std::size_t i = 1; i < numbers.size(); ++i) {
      step = std::min(step, numbers[i] - numbers[i - 1]);
    }
    for (std::int64_t const n : numbers) {
      double const frames = static_cast<double>(n - numbers.front()) / static_cast<double>(step);
      times.push_back(time_of_frame(frames, options.fps, layout.root.string()));
    }
    layout.stamps_from = to_text(options.fps) + " images a second, as asked for";
    return times;
  }
  std::vector<std::pair<int, std::string>> lines;
  for (text_line const& line : read_lines(path)) {
    if (!is_blank_or_comment(line.text)) { lines.emplace_back(line.number, trim(line.text)); }
  }
  bool const heading = lines.size() == numbers.size() + 1;
  if (heading && !begins_with_number(lines.front().second)) { lines.erase(lines.begin()); }
  bool const by_order = lines.size() == numbers.size();
  if (lines.empty() || (!by_order && numbers.back() >= static_cast<std::int64_t>(lines.size()))) {
    throw error(path + ": " + std::to_string(lines.size()) + " times, must have one for each of " +
                std::to_string(numbers.size()) + " images");
  }
  std::string unit;
  std::vector<std::int64_t> const all = times_of_lines(lines, path, unit, layout.warnings);
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    times.push_back(all[by_order ? i : static_cast<std::size_t>(numbers[i])]);
  }
  layout.stamps_from = fs::path(path).filename().string() + ", " + unit;
  return times;
}

[[noreturn]] void refuse_order(layout_of_files const& layout, std::size_t left, std::size_t others,
                               std::string const& name) {
  throw error(layout.root.string() + ": " + std::to_string(left) + " left and " +
              std::to_string(others) + " " + name +
              " images, and their names do not say which belong together");
}

/// Images that are counted, with times from elsewhere: those with equal numbers are a frame.
void by_number(std::vector<named_image> const& left, std::vector<named_image> const& right,
               std::string const& times_file, open_options const& options,
               layout_of_files& layout) {
  bool const pair = layout.kind == camera_kind::stereo;
  std::vector<std::int64_t> numbers = counters_of(left);
  std::vector<std::int64_t> others = counters_of(right);
  if (numbers.empty() || (pair && others.empty())) {  // no numbers: the order says it
    if (pair && left.size() != right.size()) {
      refuse_order(layout, left.size(), right.size(), "right");
    }
    numbers.clear();
    for (std::size_t i = 0; i < left.size(); ++i) {
      numbers.push_back(static_cast<std::int64_t>(i));
    }
    others = numbers;
  }
  layout.times = frame_times(numbers, times_file, options, layout);
  std::string const source = times_file.empty() ? layout.root.string() : times_file;
  std::size_t common = 0;
  std::vector<bool> kept(numbers.size());
  for (std::size_t const i :
       ordered_lines(layout.times, disordered::left_out, source, "frames", layout.warnings)) {
    kept[i] = true;
  }
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    auto const at = std::lower_bound(others.begin(), others.end(), numbers[i]);
    if (pair && (at == others.end() || *at != numbers[i])) { continue; }
    ++common;
    if (!kept[i]) { continue; }
    auto const k = static_cast<std::size_t>(at - others.begin());
    layout.frames.push_back({layout.times[i], left[i].file, pair ? right[k].file : std::string()});
  }
  if (layout.frames.empty()) {
    throw error(layout.root.string() + ": no stereo pair: " + std::to_string(left.size()) +
                " left and " + std::to_string(right.size()) +
                " right images, none with equal numbers");
  }
  layout.unpaired.left = static_cast<int>(numbers.size() - common);
  layout.unpaired.right = pair ? static_cast<int>(others.size() - common) : 0;
}

/// The images of a camera beside a pair that is counted: they have the times of the frames that
/// by_number() has made of the left ones.
std::vector<listed_image> at_times_of(std::vector<named_image> const& left,
                                      std::vector<named_image> const& images,
                                      std::string const& name, layout_of_files const& layout) {
  std::vector<std::int64_t> const numbers = counters_of(left);
  std::vector<std::int64_t> const others = counters_of(images);
  bool const by_order = numbers.empty() || others.empty();
  if (by_order && left.size() != images.size()) {
    refuse_order(layout, left.size(), images.size(), name);
  }
  std::vector<listed_image> listed;
  std::size_t i = 0;
  for (frame_files const& frame : layout.frames) {
    while (left[i].file != frame.left) { ++i; }
    auto const at =
        by_order ? others.end() : std::lower_bound(others.begin(), others.end(), numbers[i]);
    if (!by_order && (at == others.end() || *at != numbers[i])) { continue; }
    auto const k = by_order ? i : static_cast<std::size_t>(at - others.begin());
    listed.push_back({frame.time_ns, images[k].file});
  }
  return listed;
}

}  // namespace

namespace {

/// Depth images, or a list of them, beside one camera whose images are in no list.
void check_depth_left_out(layout_of_files& layout) {
  if (is_file((layout.root / "depth.txt").string())) {
    throw error((layout.root / "rgb.txt").string() +
                ": no such file, though there is depth.txt: both lists, or associations.txt, are a "
                "recording with depth images; --rig mono (rig=\"mono\") takes one camera alone");
  }
  for (char const* name : {"depth", "Depth", "depth_images", "aligned_depth"}) {
    fs::path const folder = with_images(layout.root / name);
    if (folder.empty()) { continue; }
    layout.warnings.push_back(
        folder.string() +
        ": depth images that are not used: no depth.txt beside rgb.txt, and no associations.txt, "
        "says which belong to the images; tracked as one camera");
    return;
  }
}

}  // namespace

void find_folder_frames(layout_of_files& layout, open_options const& options) {
  if (options.rig == camera_kind::rgbd) { refuse_depths(layout); }
  camera_folders const folders = find_camera_folders(layout.root);
  if (!folders.same_name.empty()) {
    throw error(layout.root.string() + ": " + folders.same_name +
                " differ in upper and lower case alone; accepted is one folder with images of each "
                "name, such as left and right, in any case");
  }
  if (!folders.other_pair.empty()) {
    throw error(layout.root.string() + ": several pairs of folders, such as " +
                folders.left.filename().string() + " and " + folders.other_pair +
                " with their right ones; accepted is one, or one named left and right");
  }
  if (is_pair(options.rig) && folders.right.empty()) {
    refuse_pair(layout.root.string() + ": images of one camera alone, in " + folders.left.string());
  }
  bool const pair = options.rig != camera_kind::mono && !folders.right.empty();
  layout.kind = pair ? camera_kind::stereo : camera_kind::mono;
  layout.second_folder = folders.right_name;
  if (!pair && options.rig == camera_kind::any) { check_depth_left_out(layout); }
  if (pair && options.rig == camera_kind::any && !folders.depths.empty()) {
    layout.warnings.push_back(folders.depths.front().second.string() +
                              ": depth images that are not used: --rig mixed (rig=\"mixed\") "
                              "takes all cameras, with the depth images of each");
  }
  std::vector<named_image> const left = list_images(folders.left);
  std::vector<named_image> const right = pair ? list_images(folders.right) : left;
  std::string times = options.times;
  if (times.empty() && options.fps == 0) { times = find_times(layout.root, folders.left); }
  bool const counted = options.fps > 0 || !times.empty();
  if (counted) { by_number(left, right, times, options, layout); }
  auto const beside = [&](fs::path const& folder, std::string const& name) {
    std::vector<named_image> const images = list_images(folder);
    return counted ? at_times_of(left, images, name, layout) : by_name(images, folder, layout);
  };
  if (options.rig == camera_kind::mixed) {
    for (std::size_t k = 0; k < folders.more.size(); ++k) {
      std::string const name = "cam" + std::to_string(2 + k);
      layout.more.push_back({name, beside(folders.more[k], name)});
    }
    for (auto const& [camera, folder] : folders.depths) {
      std::string const name = "depth" + std::to_string(camera);
      layout.depths.push_back({name, beside(folder, name), camera});
    }
  }
  if (counted) { return; }
  two_lists lists;
  lists.left = by_name(left, folders.left, layout);
  if (!pair) {
    take_images(lists.left, folders.left.string(), layout);
    return;
  }
  lists.second = by_name(right, folders.right, layout);
  lists.left_name = folders.left.filename().string();
  lists.second_name = folders.right.filename().string();
  pair_frames(lists, options.max_time_difference_ns.value_or(most_between_cameras_ns), layout);
}

}  // namespace seq::detail
