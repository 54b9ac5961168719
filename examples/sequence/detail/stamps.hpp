// SPDX-License-Identifier: Apache-2.0
/// @file Time stamps of lists: their unit, their order, and partners in another list. Not API.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace seq::detail {

/// Stamps of images that differ by no more than this are not in nanoseconds.
constexpr std::int64_t finest_frame_step_ns = 1'000'000;

/// A time stamp as it was written.
struct stamp_text {
  std::int64_t value;  ///< ns of one with a decimal point or an exponent, which is in seconds
  bool whole;          ///< a whole number, whose unit others say
  int line;            ///< of the file
};

/// @throws seq::error naming file and line: not a number, or too large
stamp_text read_stamp(std::string const& text, std::string const& path, int line);

/// Where some stamps are in seconds, whole numbers among them are, too, and become ns: programs
/// write 0 and 1 between 0.95 and 1.05. @return whether some are
/// @throws seq::error naming file and line for a whole number that is not between its neighbours,
///   or more than an hour from both
bool whole_seconds(std::vector<stamp_text>& stamps, std::string const& path);

/// The stamps of a file with whole numbers of ns, or with decimal fractions of seconds.
class stamp_column {
public:
  /// @param finest_ns steps of no more than this are not in nanoseconds
  stamp_column(std::string path, std::int64_t finest_ns)
      : path_(std::move(path)), finest_ns_(finest_ns) {}

  /// @throws seq::error naming file and line: not a number, or too large
  void add(std::string const& text, int line) { stamps_.push_back(read_stamp(text, path_, line)); }

  /// Nanoseconds of each, as added. Whole numbers are nanoseconds, unless their median step says
  /// that they are micro- or milliseconds or seconds; `warnings` says so then.
  /// @throws seq::error as whole_seconds()
  std::vector<std::int64_t> times_ns(std::vector<std::string>& warnings) const;

private:
  std::string path_;
  std::int64_t finest_ns_;
  std::vector<stamp_text> stamps_;
};

/// Median of the steps above 0 between neighbours; 0 without any. Differences must not overflow.
std::int64_t median_step(std::vector<std::int64_t> const& times);
double median(std::vector<double> values);

/// What becomes of lines whose time stamp is below that of a line before.
enum class disordered {
  sorted,    ///< they are put in their place
  left_out,  ///< as few lines as possible are left out, so that the rest ascends
};

/// The lines to take, in the order of their stamps, none twice: of doubled stamps the first line.
/// `warnings` says how many were left out or moved.
/// @param what the lines are, in the plural
std::vector<std::size_t> ordered_lines(std::vector<std::int64_t> const& times, disordered rule,
                                       std::string const& path, std::string const& what,
                                       std::vector<std::string>& warnings);

/// Pairs of indices whose times are at most `most_ns` apart, and of which each is the nearest to
/// the other. Both lists ascend.
std::vector<std::pair<std::size_t, std::size_t>> nearest_pairs(std::vector<std::int64_t> const& a,
                                                               std::vector<std::int64_t> const& b,
                                                               std::int64_t most_ns);

/// The smallest distance between times of two lists that ascend, ns; the largest number without.
std::int64_t smallest_distance(std::vector<std::int64_t> const& a,
                               std::vector<std::int64_t> const& b);

/// The time of a frame, ns, by how many a rate is behind the first. @param path for the message
/// @throws seq::error beyond 4.6e9 s, so that no difference of two overflows
std::int64_t time_of_frame(double frames, double rate, std::string const& path);

/// Whether a text begins as a date does: 2011-09-26 13:02:25.96
bool is_date(std::string const& text);
/// A date and time of day, UTC, with decimals of the second, as nanoseconds since 1970.
/// @throws seq::error naming file and line
std::int64_t date_to_ns(std::string const& text, std::string const& path, int line);

/// Times, ns, of numbers: seconds if one has a decimal point, else in the unit that their size or
/// their step says. @param texts with their lines in a file; in names of images
/// any
/// @param unit is set, for people @throws seq::error
std::vector<std::int64_t> times_of_texts(std::vector<std::pair<int, std::string>> const& texts,
                                         std::string const& path, std::string& unit,
                                         std::vector<std::string>& warnings);
/// The same, or dates, of a file. @throws seq::error that says what is accepted
std::vector<std::int64_t> times_of_lines(std::vector<std::pair<int, std::string>> const& lines,
                                         std::string const& path, std::string& unit,
                                         std::vector<std::string>& warnings);

/// Nanoseconds as milliseconds, for messages.
std::string milliseconds(std::int64_t ns);

}  // namespace seq::detail
