// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <iostream>
#include <sstream>
#include <streambuf>
#include <string>

namespace orbslam3_test {

/// What is said on stderr meanwhile.
class heard {
public:
  heard() : before_(std::cerr.rdbuf(text_.rdbuf())) {}
  ~heard() { std::cerr.rdbuf(before_); }
  int lines() const {
    std::string const all = text_.str();
    return static_cast<int>(std::count(all.begin(), all.end(), '\n'));
  }
  bool has(std::string const& part) const { return text_.str().find(part) != std::string::npos; }
  std::string text() const { return text_.str(); }

private:
  std::ostringstream text_;
  std::streambuf* before_;
};

}  // namespace orbslam3_test
