# SPDX-License-Identifier: Apache-2.0
"""Stands in for the onetbb package where no package server can be reached: the system's oneTBB."""

from conan import ConanFile


class SystemTbbConan(ConanFile):
    name = "onetbb"
    version = "2021.8.0"
    settings = "os", "arch", "compiler", "build_type"

    def package_info(self):
        self.cpp_info.set_property("cmake_file_name", "TBB")
        tbb = self.cpp_info.components["libtbb"]
        tbb.set_property("cmake_target_name", "TBB::tbb")
        tbb.includedirs = []
        tbb.libdirs = []
        tbb.system_libs = ["tbb"]
