// Grey PNG pictures, decoded in two thirds of the time that libpng takes: a calibration from pictures is mostly decoding.
//
// RFC 1951 (deflate) and the PNG specification (ISO/IEC 15948), sections 9 and 10. Whatever is not plain, or not whole, is
// refused, for a general decoder to judge. Checksums are the caller's.
#include "kernel.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdlib>
#include <cstring>

namespace binocal {
namespace {

constexpr std::size_t kPadding = 16;  // bytes after the compressed data, so that eight may always be loaded

class BitReader {
  public:
    BitReader(const std::uint8_t* begin, const std::uint8_t* end) : at_(begin), end_(end) {}
    // At least 56 bits, zeros beyond the data's padding; false once the padding is used up.
    bool refill() {
        if (at_ + 8 > end_) return false;
        std::uint64_t next = 0;
        if constexpr (std::endian::native == std::endian::little) {
            std::memcpy(&next, at_, 8);
        } else {
            for (int i = 7; i >= 0; --i) next = next << 8 | at_[i];
        }
        bits_ |= next << count_;
        at_ += (63 - count_) >> 3;
        count_ |= 56;
        return true;
    }
    std::uint32_t peek(int n) const { return static_cast<std::uint32_t>(bits_ & ((std::uint64_t{1} << n) - 1)); }
    void skip(int n) { bits_ >>= n, count_ -= n; }
    std::uint32_t take(int n) {
        const std::uint32_t value = peek(n);
        skip(n);
        return value;
    }
    int count() const { return count_; }
    // The bytes after the present one, for stored blocks.
    const std::uint8_t* align() {
        skip(count_ & 7);
        at_ -= count_ >> 3;
        bits_ = 0, count_ = 0;
        return at_;
    }
    void jump(const std::uint8_t* to) { at_ = to; }
    const std::uint8_t* end() const { return end_; }

  private:
    const std::uint8_t *at_, *end_;
    std::uint64_t bits_ = 0;
    int count_ = 0;
};

// Canonical Huffman codes. Codes of up to kFast bits are looked up, longer ones are counted through.
class Code {
  public:
    static constexpr int kFast = 11;
    // Packed: the bits to skip, how many literals it stands for (kOther: one length or end, 0: look elsewhere), and the two
    // literals or the symbol.
    using Entry = std::uint32_t;
    static constexpr int kOther = 3;
    static constexpr Entry pack(int bits, int literals, int value) { return static_cast<Entry>(bits | literals << 8 | value << 16); }
    static int bits_of(Entry entry) { return static_cast<int>(entry & 255); }
    static int literals_of(Entry entry) { return static_cast<int>(entry >> 8 & 255); }
    static int value_of(Entry entry) { return static_cast<int>(entry >> 16); }

    bool build(const std::uint8_t* lengths, int n, bool has_literals) {
        count_.fill(0);
        for (int i = 0; i < n; ++i) ++count_[lengths[i]];
        count_[0] = 0;
        int left = 1;
        std::array<std::uint16_t, 17> offset{};
        std::array<std::uint32_t, 17> code{};
        for (int length = 1; length <= 15; ++length) {
            left = 2 * left - count_[length];
            if (left < 0) return false;  // more codes than there are
            offset[length + 1] = static_cast<std::uint16_t>(offset[length] + count_[length]);
            code[length + 1] = (code[length] + count_[length]) << 1;
        }
        fast_.fill(0);
        for (int i = 0; i < n; ++i) {
            const int length = lengths[i];
            if (length == 0) continue;
            symbol_[offset[length]++] = static_cast<std::uint16_t>(i);
            const std::uint32_t value = code[length]++;
            if (length > kFast) continue;
            std::uint32_t reversed = 0;
            for (int k = 0; k < length; ++k) reversed |= (value >> k & 1) << (length - 1 - k);
            const Entry entry = pack(length, i < 256 ? 1 : kOther, i);
            for (std::uint32_t k = reversed; k < fast_.size(); k += 1u << length) fast_[k] = entry;
        }
        if (has_literals) join_literals();
        return true;
    }
    Entry look_up(const BitReader& in) const { return fast_[in.peek(kFast)]; }
    // One symbol, by counting through the code's lengths; -1 where there is no such code.
    int decode(BitReader& in) const {
        int code = 0, first = 0, index = 0;
        for (int length = 1; length <= 15; ++length) {
            code |= static_cast<int>(in.peek(length) >> (length - 1) & 1);
            const int count = count_[length];
            if (code - count < first) {
                in.skip(length);
                return symbol_[index + (code - first)];
            }
            index += count;
            first = (first + count) << 1;
            code <<= 1;
        }
        return -1;
    }

  private:
    // Two literals in one look-up where both codes fit: most of a noisy picture is literals of five or six bits.
    void join_literals() {
        const auto single = fast_;
        for (std::size_t i = 0; i < fast_.size(); ++i) {
            const Entry one = single[i], two = single[i >> bits_of(one)];
            const int bits = bits_of(one) + bits_of(two);
            if (literals_of(one) == 1 && literals_of(two) == 1 && bits <= kFast) fast_[i] = pack(bits, 2, value_of(one) | value_of(two) << 8);
        }
    }
    std::array<std::uint16_t, 16> count_;
    std::array<std::uint16_t, 320> symbol_;
    std::array<Entry, 1 << kFast> fast_;
};

constexpr std::uint16_t kLengthBase[29] = {3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258};
constexpr std::uint8_t kLengthExtra[29] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0};
constexpr std::uint16_t kDistanceBase[30] = {1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577};
constexpr std::uint8_t kDistanceExtra[30] = {0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13, 13};

struct Codes {
    Code literals, distances;
};

bool read_codes(BitReader& in, Codes& codes) {
    constexpr std::uint8_t order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    if (!in.refill()) return false;
    const int n_literals = static_cast<int>(in.take(5)) + 257, n_distances = static_cast<int>(in.take(5)) + 1;
    const int n_lengths = static_cast<int>(in.take(4)) + 4;
    if (n_literals > 286 || n_distances > 30) return false;
    std::array<std::uint8_t, 320> lengths{};
    for (int i = 0; i < n_lengths; ++i) {
        if (!in.refill()) return false;
        lengths[order[i]] = static_cast<std::uint8_t>(in.take(3));
    }
    if (!codes.literals.build(lengths.data(), 19, false)) return false;
    lengths.fill(0);
    for (int i = 0; i < n_literals + n_distances;) {
        if (!in.refill()) return false;
        const int symbol = codes.literals.decode(in);
        if (symbol < 0) return false;
        if (symbol < 16) {
            lengths[i++] = static_cast<std::uint8_t>(symbol);
            continue;
        }
        if (symbol == 16 && i == 0) return false;
        const std::uint8_t value = symbol == 16 ? lengths[i - 1] : 0;
        int repeat = symbol == 16 ? 3 + static_cast<int>(in.take(2)) : symbol == 17 ? 3 + static_cast<int>(in.take(3)) : 11 + static_cast<int>(in.take(7));
        if (i + repeat > n_literals + n_distances) return false;
        while (repeat--) lengths[i++] = value;
    }
    return codes.literals.build(lengths.data(), n_literals, true) && codes.distances.build(lengths.data() + n_literals, n_distances, false);
}

bool use_fixed_codes(Codes& codes) {
    std::array<std::uint8_t, 288> lengths;
    std::fill(lengths.begin(), lengths.begin() + 144, 8);
    std::fill(lengths.begin() + 144, lengths.begin() + 256, 9);
    std::fill(lengths.begin() + 256, lengths.begin() + 280, 7);
    std::fill(lengths.begin() + 280, lengths.end(), 8);
    std::array<std::uint8_t, 30> distances;
    distances.fill(5);
    return codes.literals.build(lengths.data(), 288, true) && codes.distances.build(distances.data(), 30, false);
}

// One compressed block; `out` moves on.
bool inflate_block(BitReader& reader, const Codes& codes, const std::uint8_t* begin, std::uint8_t*& written, const std::uint8_t* end) {
    BitReader in = reader;  // of its own: bytes that are written might else be the reader's
    std::uint8_t* out = written;
    for (;;) {
        // Five look-ups of 11 bits a refill, and room for the two bytes that each writes.
        Code::Entry entry;
        while (end - out >= 10) {
            if (!in.refill()) return false;
            int literals = 0;
            for (int k = 0; k < 5; ++k) {
                entry = codes.literals.look_up(in);
                literals = Code::literals_of(entry);
                if (literals != 1 && literals != 2) break;
                const int value = Code::value_of(entry);
                out[0] = static_cast<std::uint8_t>(value), out[1] = static_cast<std::uint8_t>(value >> 8);
                out += literals;
                in.skip(Code::bits_of(entry));
            }
            if (literals != 1 && literals != 2) break;
        }
        // What is no literal, has a long code, or fills the last bytes.
        if (!in.refill()) return false;
        entry = codes.literals.look_up(in);
        int symbol = Code::value_of(entry);
        if (Code::literals_of(entry) == Code::kOther) {
            in.skip(Code::bits_of(entry));
        } else {
            symbol = codes.literals.decode(in);
        }
        if (symbol < 0) return false;
        if (symbol < 256) {
            if (out == end) return false;
            *out++ = static_cast<std::uint8_t>(symbol);
        }
        if (symbol < 256) continue;
        if (symbol == 256) {
            reader = in;
            written = out;
            return true;
        }
        symbol -= 257;
        if (symbol >= 29 || !in.refill()) return false;
        const std::ptrdiff_t length = kLengthBase[symbol] + in.take(kLengthExtra[symbol]);
        const Code::Entry place = codes.distances.look_up(in);
        int code = Code::value_of(place);
        if (place) {
            in.skip(Code::bits_of(place));
        } else {
            code = codes.distances.decode(in);
        }
        if (code < 0 || code >= 30) return false;
        const std::ptrdiff_t distance = kDistanceBase[code] + in.take(kDistanceExtra[code]);
        if (distance > out - begin || length > end - out) return false;
        const std::uint8_t* from = out - distance;
        if (distance >= 8 && end - out >= length + 8) {
            for (std::ptrdiff_t i = 0; i < length; i += 8) std::memcpy(out + i, from + i, 8);
        } else {
            for (std::ptrdiff_t i = 0; i < length; ++i) out[i] = from[i];  // they overlap
        }
        out += length;
    }
}

// The zlib stream in [data, data + n), followed by kPadding bytes, into exactly n_out bytes.
bool inflate(const std::uint8_t* data, std::size_t n, std::uint8_t* out, std::size_t n_out) {
    if (n < 6 || (data[0] & 15) != 8 || (data[0] << 8 | data[1]) % 31 || data[1] & 32) return false;
    BitReader in(data + 2, data + n + kPadding);
    std::uint8_t *begin = out, *end = out + n_out;
    Codes codes;
    for (bool is_last = false; !is_last;) {
        if (!in.refill()) return false;
        is_last = in.take(1);
        const std::uint32_t kind = in.take(2);
        if (kind == 0) {
            const std::uint8_t* at = in.align();
            if (at + 4 > data + n) return false;
            const std::ptrdiff_t length = at[0] | at[1] << 8;
            if ((length ^ 0xffff) != (at[2] | at[3] << 8) || length > data + n - at - 4 || length > end - out) return false;
            std::memcpy(out, at + 4, static_cast<std::size_t>(length));
            out += length;
            in.jump(at + 4 + length);
            continue;
        }
        if (kind == 3 || !(kind == 1 ? use_fixed_codes(codes) : read_codes(in, codes))) return false;
        if (!inflate_block(in, codes, begin, out, end)) return false;
    }
    return out == end;
}

void add_rows(std::uint8_t* BINOCAL_APART row, const std::uint8_t* BINOCAL_APART above, std::size_t n) {
    for (std::size_t i = 0; i < n; ++i) row[i] = static_cast<std::uint8_t>(row[i] + above[i]);
}

// Undo a row's filter; `above` is the row before (zeros for the first), `step` the bytes of a pixel.
bool unfilter(int filter, std::uint8_t* row, const std::uint8_t* above, std::size_t n, std::size_t step) {
    auto left = [&](std::size_t i) { return i < step ? 0 : static_cast<int>(row[i - step]); };
    auto add = [&](std::size_t i, int value) { row[i] = static_cast<std::uint8_t>(row[i] + value); };
    switch (filter) {
        case 0: return true;
        case 1:
            for (std::size_t i = step; i < n; ++i) add(i, row[i - step]);
            return true;
        case 2:
            add_rows(row, above, n);
            return true;
        case 3:
            for (std::size_t i = 0; i < n; ++i) add(i, (left(i) + above[i]) >> 1);
            return true;
        case 4:
            for (std::size_t i = 0; i < n; ++i) {
                const int a = left(i), b = above[i], c = i < step ? 0 : above[i - step];
                const int pa = std::abs(b - c), pb = std::abs(a - c), pc = std::abs(a + b - 2 * c);
                add(i, pa <= pb && pa <= pc ? a : pb <= pc ? b : c);
            }
            return true;
        default: return false;
    }
}

std::uint32_t big_endian(const std::uint8_t* at) { return std::uint32_t{at[0]} << 24 | at[1] << 16 | at[2] << 8 | at[3]; }

// The data of all IDAT chunks, padded; empty where a chunk would change the pixels, or the file is cut short.
void join_data(const std::uint8_t* file, std::size_t n, std::vector<std::uint8_t>& data) {
    data.clear();
    for (std::size_t at = 8; at + 12 <= n;) {
        const std::size_t length = big_endian(file + at);
        const std::uint8_t *kind = file + at + 4, *content = file + at + 8;
        if (length > n - at - 12) break;
        if (!std::memcmp(kind, "tRNS", 4) || !std::memcmp(kind, "acTL", 4)) break;
        if (!std::memcmp(kind, "IDAT", 4)) data.insert(data.end(), content, content + length);
        if (!std::memcmp(kind, "IEND", 4)) return data.insert(data.end(), kPadding, 0), void();
        at += 12 + length;
    }
    data.clear();
}

// Fills the picture (h, w) of one or two bytes a pixel from the whole file; false where it is not plainly that.
template <typename Pixel>
bool decode_grey_png(const nb::bytes& file, nb::ndarray<Pixel, nb::ndim<2>, nb::device::cpu, nb::c_contig> picture) {
    const auto* bytes = static_cast<const std::uint8_t*>(file.data());
    const std::size_t n = file.size(), height = picture.shape(0), stride = picture.shape(1) * sizeof(Pixel);
    auto* out = reinterpret_cast<std::uint8_t*>(picture.data());
    nb::gil_scoped_release unlocked;
    static thread_local std::vector<std::uint8_t> data, filtered;  // kept, as they are large
    join_data(bytes, n, data);
    if (data.size() < kPadding + 6) return false;
    filtered.resize(height * (stride + 1));
    std::uint8_t* rows = filtered.data();
    if (!inflate(data.data(), data.size() - kPadding, rows, filtered.size())) return false;
    std::vector<std::uint8_t> zeros(stride, 0);
    const std::uint8_t* above = zeros.data();
    for (std::size_t y = 0; y < height; ++y) {
        std::uint8_t* row = rows + y * (stride + 1);
        if (!unfilter(row[0], row + 1, above, stride, sizeof(Pixel))) return false;
        above = row + 1;
        if (sizeof(Pixel) == 1) {
            std::memcpy(out + y * stride, above, stride);
        } else {
            for (std::size_t x = 0; x < stride / 2; ++x)
                picture.data()[y * (stride / 2) + x] = static_cast<Pixel>(above[2 * x] << 8 | above[2 * x + 1]);
        }
    }
    return true;
}

}  // namespace

void register_png(nb::module_& module) {
    module.def("decode_grey_png", &decode_grey_png<std::uint8_t>);
    module.def("decode_grey_png", &decode_grey_png<std::uint16_t>);
}

}  // namespace binocal
