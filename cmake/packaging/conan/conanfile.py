# SPDX-License-Identifier: Apache-2.0
"""Conan 2 recipe of this source tree: conan create cmake/packaging/conan"""

import re
from pathlib import Path

from conan import ConanFile
from conan.tools.build import check_min_cppstd
from conan.tools.files import copy
from conan.tools.layout import basic_layout

required_conan_version = ">=2.0"


class FtConan(ConanFile):
    name = "ft"
    description = "Header-only tracking front-end of visual SLAM for GPUs and CPUs"
    license = "Apache-2.0"
    topics = ("slam", "orb", "cuda", "stereo", "header-only")
    package_type = "header-library"
    settings = "os", "arch", "compiler", "build_type"
    no_copy_source = True

    @property
    def _root(self):
        return Path(self.recipe_folder).resolve().parents[2]

    def set_version(self):
        header = (self._root / "include/ft/version.hpp").read_text(encoding="utf-8")
        parts = [
            re.search(rf"^#define FT_VERSION_{part} (\d+)$", header, re.MULTILINE).group(1)
            for part in ("MAJOR", "MINOR", "PATCH")
        ]
        self.version = ".".join(parts)

    def export_sources(self):
        for pattern in ("include/*", "tests/camera_contract.hpp", "tests/camera_contract/*",
                        "tests/descriptor_contract.hpp", "tests/descriptor_contract/*", "LICENSE", "NOTICE"):
            copy(self, pattern, str(self._root), self.export_sources_folder)

    def requirements(self):
        self.requires("onetbb/[>=2021.5]", transitive_headers=True, transitive_libs=True)

    def validate(self):
        check_min_cppstd(self, 17)

    def layout(self):
        basic_layout(self)

    def package_id(self):
        self.info.clear()

    def package(self):
        copy(self, "LICENSE", self.source_folder, str(Path(self.package_folder) / "licenses"))
        copy(self, "NOTICE", self.source_folder, str(Path(self.package_folder) / "licenses"))
        copy(self, "*.hpp", str(Path(self.source_folder) / "include"), str(Path(self.package_folder) / "include"))
        for pattern in ("camera_contract.hpp", "camera_contract/*", "descriptor_contract.hpp", "descriptor_contract/*"):
            copy(self, pattern, str(Path(self.source_folder) / "tests"),
                 str(Path(self.package_folder) / "share/ft/tests"))

    def package_info(self):
        self.cpp_info.bindirs = []
        self.cpp_info.libdirs = []
        self.cpp_info.set_property("cmake_file_name", "ft")
        host = self.cpp_info.components["host"]
        host.set_property("cmake_target_name", "ft::ft")
        host.set_property("pkg_config_name", "ft")
        host.requires = ["onetbb::libtbb"]
        for name in ("camera_contract", "descriptor_contract"):
            contract = self.cpp_info.components[name]
            contract.set_property("cmake_target_name", f"ft::{name}")
            contract.includedirs = ["share/ft"]
            contract.requires = ["host"]
