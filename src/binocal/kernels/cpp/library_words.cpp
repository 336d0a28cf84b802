// What C libraries print to their standard error stream, caught thread by thread.
//
// libjpeg and libpng inside OpenCV report damage with fprintf(stderr, ...) and nowhere else. Redirecting descriptor 2 would take
// what other threads and Python write meanwhile; here only the C library's variable `stderr` points to another stream, which keeps
// the words of the threads that asked for it and passes all others on. Python's own sys.stderr does not use it. The GNU C Library
// says that `stderr` is a variable that may be set (manual, section 12.2); elsewhere nothing is caught, and the words are printed.
#include "kernel.hpp"

#include <cstdio>
#include <mutex>
#include <string>

namespace binocal {
namespace {

#if defined(__GLIBC__)

thread_local std::string* words = nullptr;  // of the thread that is catching
std::mutex gate;                            // of what follows
int n_catching = 0;
std::FILE* before = nullptr;

ssize_t keep(void*, const char* text, std::size_t size) {
    if (words == nullptr) return static_cast<ssize_t>(std::fwrite(text, 1, size, before));
    try {
        words->append(text, size);
    } catch (...) {  // no memory for them: they are lost
    }
    return static_cast<ssize_t>(size);
}

// One for the process's life: a thread that is printing may hold it after the last one has stopped catching.
std::FILE* catching_stream() {
    static std::FILE* const stream = [] {
        std::FILE* const made = fopencookie(nullptr, "w", cookie_io_functions_t{nullptr, keep, nullptr, nullptr});
        if (made != nullptr) std::setvbuf(made, nullptr, _IONBF, 0);
        return made;
    }();
    return stream;
}

void begin() {
    const std::lock_guard<std::mutex> locked(gate);
    std::FILE* const stream = catching_stream();
    if (words != nullptr || stream == nullptr) return;
    words = new std::string;
    if (n_catching++ == 0) {
        before = stderr;
        stderr = stream;
    }
}

std::string end() {
    const std::lock_guard<std::mutex> locked(gate);
    if (words == nullptr) return {};
    std::string caught = std::move(*words);
    delete words;
    words = nullptr;
    if (--n_catching == 0) stderr = before;
    return caught;
}

#else

void begin() {}
std::string end() { return {}; }

#endif

nb::bytes end_in_python() {
    const std::string caught = end();
    return nb::bytes(caught.data(), caught.size());
}

}  // namespace

void register_library_words(nb::module_& module) {
    module.def("begin_catching_words", &begin);
    module.def("end_catching_words", &end_in_python);
}

}  // namespace binocal
