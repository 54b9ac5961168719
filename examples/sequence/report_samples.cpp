// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/report_markup.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

constexpr int depth_colours = 24;

/// Near is red, far is blue: the polynomial approximation of the "turbo" map (A. Mikhailov,
/// Google), reversed and without its dark ends.
/// @param t 0 (near) to 1 (far)
std::string depth_colour(double t) {
  double const x = 0.92 - 0.84 * std::clamp(t, 0.0, 1.0);
  auto const poly = [x](std::array<double, 6> const& k) {
    double v = 0;
    for (std::size_t i = k.size(); i-- > 0;) { v = v * x + k[i]; }
    return static_cast<int>(std::lround(255 * std::clamp(v, 0.0, 1.0)));
  };
  int const red =
      poly({0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943});
  int const green =
      poly({0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604});
  int const blue =
      poly({0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973});
  return "rgb(" + std::to_string(red) + ',' + std::to_string(green) + ',' + std::to_string(blue) +
         ')';
}

/// Logarithmic, because stereo depth is proportional to one over disparity.
struct depth_scale {
  double near = 1, far = 10;
  double at(double depth) const { return std::log(depth / near) / std::log(far / near); }
  int bin(double depth) const {
    return std::clamp(static_cast<int>(std::clamp(at(depth), 0.0, 1.0) * depth_colours), 0,
                      depth_colours - 1);
  }
};

bool has_depth(sample_frame::keypoint const& k) { return std::isfinite(k.depth) && k.depth > 0; }

bool usable(sample_frame const& s) {
  return s.picture.width > 0 && s.picture.height > 0 &&
         s.picture.pixels.size() ==
             static_cast<std::size_t>(s.picture.width) * static_cast<std::size_t>(s.picture.height);
}

/// One scale for all samples, from the 2nd to the 98th percentile of their depths.
depth_scale scale_of(std::vector<sample_frame> const& samples) {
  std::vector<double> depths;
  for (sample_frame const& s : samples) {
    for (auto const& k : s.keypoints) {
      if (has_depth(k)) { depths.push_back(static_cast<double>(k.depth)); }
    }
  }
  depth_scale scale;
  if (depths.empty()) { return scale; }
  std::sort(depths.begin(), depths.end());
  scale.near = percentile(depths, 2);
  scale.far = std::max(percentile(depths, 98), scale.near * 1.5);
  return scale;
}

image halved(image const& in) {
  image out;
  out.width = in.width / 2;
  out.height = in.height / 2;
  out.pixels.resize(static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height));
  for (int y = 0; y < out.height; ++y) {
    std::uint8_t const* a = in.row(2 * y);
    std::uint8_t const* b = in.row(2 * y + 1);
    for (int x = 0; x < out.width; ++x) {
      int const sum = a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1];
      out.row(y)[x] = static_cast<std::uint8_t>((sum + 2) / 4);
    }
  }
  return out;
}

/// A JPEG of at most `budget` bytes, in a lower quality and then smaller if it has to be. A picture
/// of a few pixels may be larger than a budget that is smaller than its header.
std::vector<std::uint8_t> jpeg_within(image const& picture, std::size_t budget) {
  constexpr int widest = 1600, smallest = 16;
  image small;
  image const* source = &picture;
  for (;;) {
    bool const halvable = source->width >= 2 * smallest && source->height >= 2 * smallest;
    if (source->width <= widest || !halvable) {
      std::vector<std::uint8_t> bytes;
      for (int const quality : {82, 70, 55, 40, 25}) {
        bytes = encode_jpeg(*source, quality);
        if (bytes.size() <= budget) { return bytes; }
      }
      if (!halvable) { return bytes; }
    }
    small = halved(*source);
    source = &small;
  }
}

/// @param unit of lengths; empty where it is not known
std::string depth_bar(depth_scale const& scale, char const* unit) {
  constexpr double width = 240, cell = width / depth_colours;
  std::string out =
      "<svg class=\"depth-bar\" viewBox=\"0 0 240 28\" role=\"img\" "
      "aria-label=\"depth scale\">";
  for (int i = 0; i < depth_colours; ++i) {
    out += "<rect" + attribute("x", i * cell) + " width=\"10.5\" height=\"10\" fill=\"" +
           depth_colour((i + 0.5) / depth_colours) + "\"/>";
  }
  std::array<char const*, 3> const anchors = {"tick", "tick mid", "tick end"};
  for (std::size_t i = 0; i < anchors.size(); ++i) {
    double const t = 0.5 * static_cast<double>(i);
    double const depth = scale.near * std::pow(scale.far / scale.near, t);
    out += chart::text(width * t, 24, anchors[i],
                       fixed(depth, depth < 10 ? 1 : 0) + (i == 2 ? unit : ""));
  }
  return out + "</svg>";
}

/// A figure without its picture, which goes between the two.
struct figure_parts {
  std::string before, after;
};

/// @param zoom size of marks: 1 for a picture as wide as the page
/// @param step every so many-th keypoint is drawn
figure_parts sample_figure(sample_frame const& s, depth_scale const& scale, double zoom,
                           std::size_t step) {
  double const width = s.picture.width, height = s.picture.height;
  // marks have about the same size on paper for every picture size
  double const unit = zoom * std::clamp(width / 1000, 0.2, 4.0);
  float least_size = std::numeric_limits<float>::max();
  for (auto const& k : s.keypoints) {
    if (std::isfinite(k.size) && k.size > 0) { least_size = std::min(least_size, k.size); }
  }
  auto const radius = [&](sample_frame::keypoint const& k) {
    double const growth = std::isfinite(k.size) && k.size > 0
                              ? static_cast<double>(k.size / least_size)
                              : std::pow(1.2, std::clamp(k.octave, 0, 12));
    return unit * std::min(2.4 * growth, 16.0);
  };

  std::string unmatched, no_stereo;
  std::array<std::string, depth_colours> stereo, tracked;
  pen tracks;
  int total = 0, with_depth = 0, inliers = 0;
  for (auto const& k : s.keypoints) {
    if (!std::isfinite(k.x) || !std::isfinite(k.y)) { continue; }
    double const x = static_cast<double>(k.x), y = static_cast<double>(k.y);
    std::string const circle =
        "<circle" + attribute("cx", x) + attribute("cy", y) + attribute("r", radius(k)) + "/>";
    inliers += static_cast<int>(k.matched);
    with_depth += static_cast<int>(has_depth(k));
    if (static_cast<std::size_t>(total++) % step != 0) { continue; }
    if (has_depth(k)) {
      auto const bin = static_cast<std::size_t>(scale.bin(static_cast<double>(k.depth)));
      (k.matched ? tracked : stereo)[bin] += circle;
    } else {
      (k.matched ? no_stereo : unmatched) += circle;
    }
    if (k.from_x >= 0 && k.from_y >= 0 && std::isfinite(k.from_x) && std::isfinite(k.from_y)) {
      tracks.cut();
      tracks.to(static_cast<double>(k.from_x), static_cast<double>(k.from_y));
      tracks.to(x, y);
    }
  }

  figure_parts parts;
  parts.before = "<figure>\n<svg class=\"sample\" viewBox=\"0 0 " + coordinate(width) + ' ' +
                 coordinate(height) + "\" role=\"img\" aria-label=\"frame " +
                 std::to_string(s.index) + "\">\n<image width=\"" + coordinate(width) +
                 "\" height=\"" + coordinate(height) + "\" preserveAspectRatio=\"none\" " +
                 "href=\"data:image/jpeg;base64,";
  std::string& out = parts.after;
  out = "\"/>\n<rect class=\"shade\" width=\"" + coordinate(width) + "\" height=\"" +
        coordinate(height) + "\"/>\n";
  auto const group = [&](std::string const& circles, std::string const& colour, double stroke,
                         double opacity) {
    if (circles.empty()) { return; }
    out += "<g fill=\"none\" stroke=\"" + colour + "\" stroke-width=\"" + fixed(stroke * unit, 2) +
           "\" stroke-opacity=\"" + fixed(opacity, 2) + "\">" + circles + "</g>\n";
  };
  group(unmatched, "#b9c0ca", 1.0, 0.75);
  for (std::size_t i = 0; i < stereo.size(); ++i) {
    group(stereo[i], depth_colour((static_cast<double>(i) + 0.5) / depth_colours), 0.9, 0.8);
  }
  if (std::string const data = tracks.take(); !data.empty()) {
    out +=
        "<path fill=\"none\" stroke=\"#ff5cf0\" stroke-opacity=\"0.9\" stroke-linecap=\"round\" "
        "stroke-width=\"" +
        fixed(1.3 * unit, 2) + "\" d=\"" + data + "\"/>\n";
  }
  group(no_stereo, "#ffffff", 2.0, 1.0);
  for (std::size_t i = 0; i < tracked.size(); ++i) {
    group(tracked[i], depth_colour((static_cast<double>(i) + 0.5) / depth_colours), 2.0, 1.0);
  }
  out += "</svg>\n<figcaption><b>Frame " + std::to_string(s.index) + "</b> " + grouped(total) +
         " keypoints, " + grouped(with_depth) + " with depth, " + grouped(inliers) +
         " inliers</figcaption>\n</figure>\n";
  return parts;
}

/// How many keypoints there are for each that is drawn.
std::size_t drawing_step(std::vector<sample_frame const*> const& frames) {
  constexpr std::size_t most_rings = 8000;
  std::size_t keypoints = 0;
  for (sample_frame const* s : frames) { keypoints += s->keypoints.size(); }
  return keypoints / most_rings + 1;
}

}  // namespace

std::string sample_section(run_report const& r, std::size_t budget) {
  std::vector<sample_frame const*> frames;
  for (sample_frame const& s : r.samples) {
    if (usable(s)) { frames.push_back(&s); }
  }
  if (frames.empty()) { return {}; }
  depth_scale const scale = scale_of(r.samples);
  std::string out = section_open("Keypoints and tracks",
                                 std::string(r.one_camera || r.depth_images ? "" : "Left image. ") +
                                     "A ring's size is its pyramid level's, its colour the depth; "
                                     "a line leads from where the same map point was seen "
                                     "in the frame before.");
  // the rings are drawn on dark: their colours are chosen for the pictures, not for the page
  out += "<div class=\"legend\">\n<span class=\"key\">depth " +
         depth_bar(scale, r.metric ? " m" : "") + "</span>\n";
  auto const ring = [&](char const* colour, char const* stroke, char const* words) {
    out += std::string(
               "<span class=\"key\"><svg class=\"swatch\" viewBox=\"0 0 22 12\"><rect "
               "width=\"22\" height=\"12\" rx=\"2\" fill=\"#3a3f47\"/><circle cx=\"11\" "
               "cy=\"6\" r=\"4\" fill=\"none\" stroke=\"") +
           colour + "\" stroke-width=\"" + stroke + "\"/></svg>" + words + "</span>\n";
  };
  std::string const example = depth_colour(0.45);
  ring(example.c_str(), "2", "inlier map point");
  ring(example.c_str(), "0.8", "depth only");
  ring("#ffffff", "2", "inlier without depth");
  ring("#b9c0ca", "1", "unmatched");
  out +=
      "<span class=\"key\"><svg class=\"swatch\" viewBox=\"0 0 22 12\"><rect width=\"22\" "
      "height=\"12\" rx=\"2\" fill=\"#3a3f47\"/><path d=\"M3 9L19 3\" stroke=\"#ff5cf0\" "
      "stroke-width=\"1.6\"/></svg>track</span>\n</div>\n";
  bool const narrow = std::all_of(frames.begin(), frames.end(), [](sample_frame const* s) {
    return s->picture.width < 2 * s->picture.height;
  });
  bool const pairs = narrow && frames.size() > 1;
  out += pairs ? "<div class=\"samples pairs\">\n" : "<div class=\"samples\">\n";
  std::string const end = "</div></section>\n";
  std::size_t used = out.size() + end.size();
  std::size_t const step = drawing_step(frames);
  std::vector<figure_parts> figures;
  for (sample_frame const* s : frames) {
    figures.push_back(sample_figure(*s, scale, pairs ? 1.6 : 1.0, step));
    used += figures.back().before.size() + figures.back().after.size();
  }
  // base64 has four characters for three bytes
  std::size_t const room = budget > used ? (budget - used) / frames.size() / 4 * 3 : 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    out += figures[i].before + base64(jpeg_within(frames[i]->picture, room)) + figures[i].after;
  }
  return out + end;
}

}  // namespace seq::detail
