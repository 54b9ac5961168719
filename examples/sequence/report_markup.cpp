// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/report_markup.hpp"

#include <limits>

#include "examples/sequence/report_figures.hpp"

namespace seq::detail {
namespace {

/// 1, 2 or 5 times a power of ten, so that about `count` steps cover `span`.
double nice_step(double span, double count) {
  double const raw = span / std::max(count, 1.0);
  if (!(raw > 0) || !std::isfinite(raw)) { return 1; }
  double const power = std::pow(10.0, std::floor(std::log10(raw)));
  double const mantissa = raw / power;
  return power * (mantissa <= 1.0001 ? 1 : mantissa <= 2.0001 ? 2 : mantissa <= 5.0001 ? 5 : 10);
}

std::string tick_text(double value, double step) {
  int const digits = step >= 1 ? 0 : static_cast<int>(std::ceil(-std::log10(step) - 1e-9));
  return fixed(value, std::min(digits, 6));
}

/// Multiples of `step` within the axis, at most a hundred. On a short axis far from zero (a run
/// that diverged) the step may be below the resolution of its numbers.
std::vector<double> ticks(range const& axis, double step) {
  std::vector<double> out;
  double const first = std::ceil(axis.low / step - 1e-9) * step;
  for (int i = 0; i < 100; ++i) {
    double const t = first + i * step;
    if (!(t <= axis.high + step * 1e-6)) { break; }
    out.push_back(t);
  }
  return out;
}

}  // namespace

std::string escape(std::string const& text) {
  std::string out;
  out.reserve(text.size());
  for (char const c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        // control characters are not allowed in HTML
        out += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? ' ' : c;
    }
  }
  return out;
}

std::string coordinate(double value) {
  if (!std::isfinite(value)) { return "0"; }
  std::int64_t const tenths = std::llround(std::clamp(value, -1e6, 1e6) * 10);
  std::int64_t const magnitude = std::abs(tenths);
  std::string text = std::to_string(magnitude / 10);
  if (magnitude % 10 != 0) { text += '.' + std::to_string(magnitude % 10); }
  return tenths < 0 ? '-' + text : text;
}

std::string attribute(char const* name, double value) {
  return std::string(" ") + name + "=\"" + coordinate(value) + '"';
}

std::string grouped(long long value) {
  std::string text = std::to_string(value);
  std::ptrdiff_t const first = value < 0 ? 1 : 0;
  for (std::ptrdiff_t i = static_cast<std::ptrdiff_t>(text.size()) - 3; i > first; i -= 3) {
    text.insert(static_cast<std::size_t>(i), "\xe2\x80\xaf");
  }
  return text;
}

std::string significant(double value) {
  double const size = std::abs(value);
  return fixed(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : size >= 0.1 ? 3 : 4);
}

std::string base64(std::vector<std::uint8_t> const& bytes) {
  static constexpr char digits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::size_t const n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t word = std::uint32_t{bytes[i]} << 16U;
    if (n > 1) { word |= std::uint32_t{bytes[i + 1]} << 8U; }
    if (n > 2) { word |= std::uint32_t{bytes[i + 2]}; }
    out += digits[word >> 18U & 63U];
    out += digits[word >> 12U & 63U];
    out += n > 1 ? digits[word >> 6U & 63U] : '=';
    out += n > 2 ? digits[word & 63U] : '=';
  }
  return out;
}

std::string path(std::string const& style, std::string const& data) {
  if (data.empty()) { return {}; }
  return "<path class=\"" + style + "\" d=\"" + data + "\"/>\n";
}

std::string chart::x_axis(std::string const& title, bool whole) const {
  std::string grid, labels;
  double const floor_y = top + inner_height();
  double step = nice_step(x.span(), inner_width() / 95);
  if (whole) { step = std::max(step, 1.0); }
  for (double const t : ticks(x, step)) {
    grid += 'M' + coordinate(px(t)) + ' ' + coordinate(top) + 'V' + coordinate(floor_y);
    labels += text(px(t), floor_y + 17, "tick mid", tick_text(t, step));
  }
  return path("grid", grid) + labels +
         text(left + inner_width() / 2, height - 6, "axis mid", title);
}

std::string chart::axes(std::string const& x_title, std::string const& y_title, bool whole_x,
                        bool whole_y) const {
  std::string grid, labels;
  double step = nice_step(y.span(), inner_height() / 36);
  if (whole_y) { step = std::max(step, 1.0); }
  for (double const t : ticks(y, step)) {
    grid += 'M' + coordinate(left) + ' ' + coordinate(py(t)) + 'H' + coordinate(width - right);
    labels += text(left - 8, py(t) + 4, "tick end", tick_text(t, step));
  }
  return x_axis(x_title, whole_x) + path("grid", grid) + labels +
         "<text class=\"axis mid\" transform=\"translate(14 " +
         coordinate(top + inner_height() / 2) + ") rotate(-90)\">" + escape(y_title) + "</text>\n";
}

std::string legend_entry(std::string const& style, mark shape, std::string const& words) {
  std::string out = "<span class=\"key\"><svg class=\"swatch\" viewBox=\"0 0 22 12\">";
  switch (shape) {
    case mark::line:
      out += "<path class=\"" + style + "\" d=\"M1 6H21\"/>";
      break;
    case mark::area:
      out += "<rect class=\"" + style + "\" x=\"5\" y=\"0\" width=\"12\" height=\"12\" rx=\"2\"/>";
      break;
    case mark::tick:
      out += "<path class=\"" + style + "\" d=\"M11 2V10\"/>";
      break;
    case mark::dot:
      out += "<circle class=\"" + style + "\" cx=\"11\" cy=\"6\" r=\"4.5\"/>";
      break;
  }
  return out + "</svg>" + escape(words) + "</span>\n";
}

std::string section_open(std::string const& title, std::string const& caption) {
  std::string out = "<section>\n<h2>" + escape(title) + "</h2>\n";
  if (!caption.empty()) { out += "<p class=\"caption\">" + escape(caption) + "</p>\n"; }
  return out;
}

std::string nothing(std::string const& words) {
  return "<p class=\"nothing\">" + escape(words) + "</p>\n";
}

std::vector<bucket> buckets_of(std::vector<frame_record> const& records, std::size_t most) {
  std::vector<bucket> out;
  std::size_t const size = std::max<std::size_t>(1, (records.size() + most - 1) / most);
  for (std::size_t i = 0; i < records.size(); i += size) {
    bucket b;
    b.begin = i;
    b.end = std::min(i + size, records.size());
    double sum = 0;
    for (std::size_t k = b.begin; k < b.end; ++k) { sum += records[k].index; }
    b.x = sum / static_cast<double>(b.end - b.begin);
    out.push_back(b);
  }
  return out;
}

range index_range(std::vector<frame_record> const& records) {
  range r{std::numeric_limits<double>::max(), std::numeric_limits<double>::lowest()};
  for (frame_record const& f : records) {
    r.low = std::min(r.low, static_cast<double>(f.index));
    r.high = std::max(r.high, static_cast<double>(f.index));
  }
  if (!(r.span() > 0)) { r = {r.low - 0.5, r.low + 0.5}; }
  return r;
}

}  // namespace seq::detail
